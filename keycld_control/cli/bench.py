"""Measure everything that KeyCLD promises, and print it beside what it must reach."""

import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from tyro.conf import UseAppendAction

from keycld_control.cli._output import print_result
from keycld_control.cli.doctor import examine
from keycld_control.plain_json import write_json

if TYPE_CHECKING:
    from keycld_control.benchmarks.figure import Figure
    from keycld_control.benchmarks.weights import Weights

Part = Literal["envs", "positions", "act", "models", "swingup", "intervals"]
PARTS: tuple[Part, ...] = ("envs", "positions", "act", "models", "swingup")
"""What is measured unless told otherwise; "intervals" takes an hour more."""


@dataclass(frozen=True)
class Args:
    """Measure everything that KeyCLD promises, and print it beside what it must reach; half an hour on two cores.

    Attributes:
        only: Part to measure, repeatable: "envs" (frames/s), "positions" (read off frames), "act" (actions/s), "models"
            (prediction, angles, training time), "swingup" (success), "intervals" (how often they hold what is true,
            an hour); by default all but the last.
        system: System to measure, repeatable; by default all; `keycld systems` lists them.
        weights: Folder with a checkpoint per system, named like it; by default the shipped weights.
        data: Folder with a data set per system, named like it; by default, the paper's data set is collected anew with
            the seed of the weights.
        episodes: Episodes of every swing-up series.
        mechanisms: Mechanisms that are drawn for "intervals".
        workers: Number of processes that swing up and collect; no figure but the seconds depends on it.
        seed: Seed of the first episode of every series.
        out: Write the report to this JSON file, and what is known so far after every part.
        json: Print one JSON object.
    """

    only: Annotated[tuple[Part, ...], UseAppendAction] = ()
    system: Annotated[tuple[str, ...], UseAppendAction] = ()
    weights: Path | None = None
    data: Path | None = None
    episodes: int = 100
    mechanisms: int = 51
    workers: int = 2
    seed: int = 0
    out: Path | None = None
    json: bool = False


def run(args: Args) -> None:
    """Measure and print; exit code 0 whatever the figures are."""
    from keycld_control.benchmarks.weights import Weights
    from keycld_envs.errors import InputError
    from keycld_envs.systems import chosen_systems

    for name in ("episodes", "mechanisms", "workers"):
        if getattr(args, name) < 1:
            raise InputError(f"{name} is {getattr(args, name)}; it must be at least 1.")
    if args.seed < 0:
        raise InputError(f"seed is {args.seed}; it must be at least 0.")
    parts: tuple[Part, ...] = tuple(part for part in get_args(Part) if part in (args.only or PARTS))
    weights = Weights(chosen_systems(args.system), args.weights)
    if args.data is not None and (missing := [s for s in weights.systems if not (args.data / s).is_dir()]):
        raise InputError(f"{args.data} has no folder {missing[0]!r}; it must hold one data set per system.")
    if set(parts) - {"envs", "positions"}:
        weights.check()
    report = {"machine": machine(), "settings": asdict(args) | {"only": parts}, "complete": False, "figures": []}
    for part in parts:
        report["figures"] += [row(figure) for figure in _measure(part, args, weights)]
        report["complete"] = part == parts[-1]
        if args.out is not None:
            write_json(args.out, report)
    if args.json:
        print_result(report, as_json=True)
    else:
        _print(report)


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    found = examine()
    return {
        "cpu": _cpu(),
        "cpus": found["cpus"],
        "load_average": [round(load, 2) for load in os.getloadavg()],
        "platform": found["platform"],
        "python": found["python"],
        "keycld": found["keycld"],
        "opengl": found["opengl"]["renderer"] or found["opengl"]["error"],
        "packages": {name: package["version"] for name, package in found["packages"].items()},
    }


def row(figure: "Figure") -> dict[str, Any]:
    """A figure as JSON-compatible data."""
    return asdict(figure) | {"met": figure.met}


def _measure(part: Part, args: Args, weights: "Weights") -> Iterator["Figure"]:
    """Import only what the part needs: dm_control opens an OpenGL display when imported."""
    if part == "envs":
        from keycld_control.benchmarks.envs import speed_figures

        yield from speed_figures(weights.systems)
    elif part == "positions":
        from keycld_control.benchmarks.positions import position_figures

        yield from position_figures(weights.systems, args.seed)
    elif part == "act":
        from keycld_control.benchmarks.act import act_per_second

        yield from act_per_second(weights, args.seed)
    elif part == "models":
        from keycld_control.benchmarks.models import model_figures

        yield from model_figures(weights, args.data, args.workers)
    elif part == "intervals":
        from keycld_control.benchmarks.intervals.coverage import interval_figures, trained_figures

        yield from trained_figures(weights, args.seed)
        yield from interval_figures(args.mechanisms, args.seed)
    else:
        from keycld_control.benchmarks.swingup import swing_up_success

        yield from swing_up_success(weights, args.episodes, args.workers, args.seed)


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _print(report: Mapping[str, Any]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console, table = Console(), Table(box=box.SIMPLE)
    columns = ("measure", "system", "required", "reached", "95 % interval", "n", "")
    for column in columns:
        table.add_column(column, justify="left" if column in columns[:2] else "right")
    for figure in report["figures"]:
        table.add_row(*cells(figure), style="bold red" if figure["met"] is False else None)
    console.print(table)
    for reason in sorted({f["details"]["reason"] for f in report["figures"] if "reason" in f["details"]}):
        console.print(reason, highlight=False)
    about, settings = report["machine"], report["settings"]
    console.print(
        f"{about['cpu']}, {about['cpus']} CPU(s), load {about['load_average'][0]:g}; {about['platform']}; "
        f"{about['opengl']}",
        highlight=False,
    )
    versions = ", ".join(f"{name} {about['packages'].get(name)}" for name in ("mujoco", "jax", "flax", "numpy"))
    console.print(
        f"keycld {about['keycld']}, Python {about['python']}, {versions}; seed {settings['seed']}, "
        f"{settings['workers']} worker(s)",
        highlight=False,
    )


def cells(figure: Mapping[str, Any]) -> Sequence[str]:
    """One line of the table."""
    bound, interval = figure["required"], figure["interval"]
    return (
        figure["measure"],
        figure["system"],
        "–" if bound is None else f"{'≤' if figure['at_most'] else '≥'} {bound:g}",
        "–" if figure["reached"] is None else f"{figure['reached']:.5g}",
        "" if interval is None else f"{interval[0]:.3f} – {interval[1]:.3f}",
        "" if figure["count"] is None else str(figure["count"]),
        {True: "met", False: "missed", None: ""}[figure["met"]],
    )
