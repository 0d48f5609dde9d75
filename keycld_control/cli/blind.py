"""Measure the diagnosis on sealed cases with known missing physics."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Measure the diagnosis on sealed cases with known missing physics.

    `make` writes cases and their answers; `run` diagnoses all cases without opening the answers; `score` compares;
    `ideal` tells how many single effects can be told from the nearest other one. All but `score` continue where they
    stopped.

    Attributes:
        action: "make", "run", "score", or "ideal".
        out: Folder of the benchmark.
        cases: make: number of cases.
        seed: make: determines every byte of the cases.
        observe: make: what is recorded, joint positions ("states") or frames alone ("pixels").
        only: make: categories of cases, by default all.
        method: run: "diagnose", "refit", "greedy", "sindy", "neural", or your own as module:function.
        workers: make, run, ideal: number of processes; no figure but the seconds depends on it.
        ray: make, run: do it on a Ray cluster: "local", "auto" or host:port; all its machines must see the folder.
        partial: score: leave out cases that have no report yet.
        json: Print one JSON object.
    """

    action: Positional[Literal["make", "run", "score", "ideal"]]
    out: Positional[Path]
    cases: int = 300
    seed: int = 0
    observe: Literal["states", "pixels"] = "states"
    only: tuple[Literal["null", "one", "two", "three", "outside"], ...] = ()
    method: str = "diagnose"
    workers: int = 2
    ray: str | None = None
    partial: bool = False
    json: bool = False


def run(args: Args) -> None:
    """Make, run, score, or tell what could be reached."""
    keep_compiled()
    from keycld_envs.errors import InputError

    if args.workers < 1:
        raise InputError(f"workers is {args.workers}; it must be at least 1.")
    if args.action == "make":
        from keycld_control.benchmarks.blind.make import CATEGORIES, Settings, make

        settings = Settings(args.seed, args.cases, args.observe, args.only or CATEGORIES)
        manifest = make(args.out, settings, args.workers, args.ray)
        print_result(manifest, as_json=args.json)
        if not args.json:
            print(f"SHA-256 of the answers: {manifest['answers_sha256']}")  # the table may cut it
    elif args.action == "run":
        from keycld_control.benchmarks.blind.run import run as run_method

        print_result(run_method(args.out, args.method, args.workers, args.ray), as_json=args.json)
    elif args.action == "ideal":
        from keycld_control.benchmarks.blind.ideal_observer import ideal_observer
        from keycld_control.benchmarks.blind.tables import print_ideal

        best = ideal_observer(args.out, args.workers)
        if args.json:
            print_result(best, as_json=True)
        else:
            print_ideal(best)
    else:
        from keycld_control.benchmarks.blind.score import score
        from keycld_control.benchmarks.blind.tables import print_score

        result = score(args.out, args.partial)
        if args.json:
            print_result(result, as_json=True)
        else:
            print_score(result)
