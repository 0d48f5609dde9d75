"""Close the loop: conceal physics in a mechanism, explore it, diagnose it, correct the agent, and count successes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result

ARMS = ("before", "after", "true", "fine_tuned")


@dataclass(frozen=True)
class Args:
    """Conceal physics in a mechanism, explore it, diagnose it, correct the agent, and count successes before and after.

    Effects are drawn by seed until the agent that does not know of them fails in most of six episodes, whose starts are
    not among those that are counted. Run again with the same settings, it continues where it stopped.

    Attributes:
        system: Short name (`keycld systems` lists them) or environment id, with shipped weights.
        conceal: Seed of the first combination of effects; the following ones count up.
        combinations: Number of combinations.
        out: Folder, with a folder for each combination: recordings, report.json, the corrected checkpoint, results.
        episodes: Episodes that are counted after the correction.
        baseline_episodes: Episodes of each other column (before, true, fine-tuned), with the same first starts; as many
            as after the correction if it is not given.
        recordings: Runs of the exploration, of 200 frames each.
        experiments: Experiments to follow, at most, that a diagnosis proposes to tell rivals apart, each with another
            diagnosis after it.
        observe: What the diagnosis compares: frames ("pixels"), measured joint positions ("states"), or both.
        fine_tune: Also train the model on the same recordings, and count with it.
        workers: Number of processes; the result does not depend on it.
        seed: Seed of the first counted episode.
        json: Print one JSON object.
    """

    system: Positional[str]
    conceal: int
    out: Path
    combinations: int = 1
    episodes: int = 100
    baseline_episodes: int | None = None
    recordings: int = 12
    experiments: int = 1
    observe: Literal["pixels", "both", "states"] = "pixels"
    fine_tune: bool = False
    workers: int = 1
    seed: int = 0
    json: bool = False


def run(args: Args) -> None:
    """Run the loops and print a table."""
    keep_compiled()
    from keycld_control.correction.loop import LoopPlan, close_the_loop
    from keycld_envs.errors import InputError

    if args.combinations < 1:
        raise InputError(f"combinations is {args.combinations}; it must be at least 1.")
    rows = []
    for seed in range(args.conceal, args.conceal + args.combinations):
        plan = LoopPlan(
            args.system,
            seed,
            args.episodes,
            args.baseline_episodes,
            args.recordings,
            args.experiments,
            args.observe,
            args.fine_tune,
            args.seed,
        )
        rows.append(close_the_loop(plan, args.out / f"{seed:05d}", args.workers))
    if args.json:
        print_result({"rows": rows}, as_json=True)
    else:
        _print_table(rows)


def _print_table(rows: list[dict[str, Any]]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    arms = [arm for arm in ARMS if arm in rows[0]]
    table = Table("seed", "concealed", "found", *(arm.replace("_", " ") for arm in arms), box=box.SIMPLE)
    for row in rows:
        counts = (f"{row[arm]['successes']}/{row[arm]['episodes']}" for arm in arms)
        table.add_row(str(row["conceal"]), _words(row["concealed"]), _words(row["found"]) or "–", *counts)
    Console().print(table)


def _words(effects: list[dict[str, Any]]) -> str:
    """Effects as text, one a line."""
    return "\n".join(
        f"{e['effect']} at {e['where']['name']} "
        + ", ".join(f"{name} {number['value']:.3g} {number['unit']}" for name, number in e["parameters"].items())
        for e in effects
    )
