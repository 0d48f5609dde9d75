"""Train, or load, and measure every model of the KeyCLD paper, and write the report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import UseAppendAction

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Train, or load, and measure every model of the KeyCLD paper; one page and one Markdown table show it.

    A model takes about ten minutes on two cores, and there are dozens; run again, it goes on where it stopped, and
    report.html holds what is known so far after every call. Parts can run in other processes and on other machines that
    see the folder.

    Attributes:
        out: Folder of the report, of data, models and results; one folder per --seed.
        system: System, repeatable; by default all; `keycld systems` lists them.
        preset: Recipe of the models, repeatable; by default all of the report.
        seeds: Seeds of training per model.
        sequences: Training sequences, repeatable; by default 450, and 25 to 200 for the default's first seed.
        retrain: Train also what the shipped weights are of, if it has no figures yet.
        only_report: Write the report from what is there; train and measure nothing.
        workers: Number of processes.
        ray: Do it on a Ray cluster: "local", "auto" or host:port; all its machines must see the folder.
        seed: Seed of the data; tests have others, made from it.
        json: Print one JSON object.
    """

    out: Path
    system: Annotated[tuple[str, ...], UseAppendAction] = ()
    preset: Annotated[tuple[str, ...], UseAppendAction] = ()
    seeds: int = 3
    sequences: Annotated[tuple[int, ...], UseAppendAction] = ()
    retrain: bool = False
    only_report: bool = False
    workers: int = 1
    ray: str | None = None
    seed: int = 1
    json: bool = False


def run(args: Args) -> None:
    """Work off what is missing, then write and name the report."""
    keep_compiled()
    from keycld_control.paper.page import write_report
    from keycld_control.paper.plan import AMOUNTS, TITLES, WHOLE, trainings
    from keycld_control.paper.work import Work, results, work_off
    from keycld_envs.errors import InputError
    from keycld_envs.systems import chosen_systems

    for name, least in (("seeds", 1), ("workers", 1), ("seed", 0)):
        if getattr(args, name) < least:
            raise InputError(f"{name} is {getattr(args, name)}; it must be at least {least}.")
    if unknown := [name for name in args.preset if name not in TITLES]:
        raise InputError(f"--preset names {unknown[0]!r}; there are {', '.join(TITLES)}.")
    planned = list(trainings(chosen_systems(args.system), args.seeds))
    wanted = [
        t
        for t in planned
        if (not args.preset or t.preset in args.preset) and (not args.sequences or t.sequences in args.sequences)
    ]
    if not wanted:
        amounts = ", ".join(map(str, AMOUNTS))
        raise InputError(
            "Nothing that is planned has these presets and sequences; leave one of them out. "
            f"There are {WHOLE} sequences of every preset, and {amounts} of the default's first seed."
        )
    if not args.only_report:
        work_off(Work(args.out, args.seed, shipped=not args.retrain), wanted, args.workers, args.ray)
    found = results(args.out)
    if not found:
        raise InputError(f"{args.out} holds no results; run without --only-report.")
    write_report(args.out, found)
    summary = {"models": len(found), "planned": len(planned), "report": str(args.out / "report.html")}
    print_result(summary, as_json=args.json)
