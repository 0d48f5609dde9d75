"""Tell the smallest effects that a comparison would find on a rig."""

from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result
from keycld_control.cli._simulator import simulator_of

if TYPE_CHECKING:
    from keycld_model.diagnosis.discrepancy.detectable import Detectable


@dataclass(frozen=True)
class Args:
    """Tell, for every effect and place, the smallest size that `keycld diagnose --baseline` would find in one new run.

    Attributes:
        recordings: Folder of recordings of the mechanism as it is, at least two; they are the baseline.
        env: Environment that simulates it; by default the one that the recordings name.
        mjcf: MuJoCo XML file of it instead.
        out: HTML file to write, with a picture of the forces of these sizes.
        json: Print one JSON object.
    """

    recordings: Positional[Path]
    env: str | None = None
    mjcf: Path | None = None
    out: Path | None = None
    json: bool = False


def run(args: Args) -> None:
    """Compute, draw, and print a table."""
    keep_compiled()
    from keycld_envs.errors import InputError
    from keycld_envs.files import check_place
    from keycld_envs.progress import progress
    from keycld_envs.recordings import read_dataset
    from keycld_model.diagnosis.discrepancy.detectable import detectable

    if args.out is not None and args.out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out is {args.out}; the page must end in .html.")
    if args.out is not None:
        check_place(args.out)
    recordings = read_dataset(args.recordings).recordings
    model = simulator_of(args.recordings, recordings, args.mjcf, args.env).model
    with progress("Looking", total=100) as advance:
        found = detectable(recordings, model, advance=advance)
    others = _others(found)
    if args.out is not None:
        _draw(found, others, args.out)
    if args.json:
        rows = [
            {k: v if not isinstance(v, float) or isfinite(v) else None for k, v in asdict(d).items()} for d in found
        ]
        print_result({"detectable": rows, "not_asked": others}, as_json=True)
    else:
        _print_table(found, others)


def _others(found: "list[Detectable]") -> list[str]:
    """Effects that no size can be told of: a comparison does not look for them, or not to first order."""
    from keycld_envs.effects import EFFECTS

    return sorted(set(EFFECTS) - {d.effect for d in found})


def _print_table(found: "list[Detectable]", others: list[str]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table("place", "effect", "smallest difference", "force, rms", box=box.SIMPLE)
    for d in found:
        table.add_row(*_row(d))
    console = Console()
    console.print(table)
    console.print(f"No size is told of {_listed(others)}.", highlight=False)


def _row(d: "Detectable") -> tuple[str, str, str, str]:
    """Place, effect, least difference and its force, for people."""
    from keycld_model.diagnosis.output.words import effect_name

    where = "gravity" if d.where == d.kind else f"{d.kind} {d.where}"
    return where, effect_name(d.effect), _size(d), f"{d.force:.2g}" if isfinite(d.force) else ""


def _size(d: "Detectable") -> str:
    from keycld_model.diagnosis.output.words import unit

    return f"{d.parameter} = {d.size:.2g} {unit(d.unit)}".strip() if isfinite(d.size) else f"{d.parameter}: none"


def _listed(effects: list[str]) -> str:
    from keycld_envs.effects import phrase

    return ", ".join(map(phrase, effects))


def _draw(found: "list[Detectable]", others: list[str], path: Path) -> None:
    """Bars of the forces that the smallest sizes make, by place, and a table; offline."""
    import plotly.graph_objects as go

    from keycld_control.plots import plotly_script, plotted
    from keycld_envs.files import atomic_file
    from keycld_envs.templates import templates
    from keycld_model.diagnosis.output.words import effect_name

    shown = [d for d in found if isfinite(d.force) and d.force > 0]
    figure = go.Figure()
    for where in dict.fromkeys(d.where for d in shown):
        own = sorted((d for d in shown if d.where == where), key=lambda d: d.force)
        figure.add_bar(
            name=where,
            x=[d.force for d in own],
            y=[f"{effect_name(d.effect)} {d.parameter}, {d.where}" for d in own],
            orientation="h",
            text=[_size(d) for d in own],
        )
    figure.update_xaxes(type="log", title="force along the recorded motion, N m or N, root mean square")
    with atomic_file(path, "w") as file:
        file.write(
            templates("keycld_control.detectable")
            .get_template("page.html")
            .render(
                rows=[_row(d) for d in found],
                others=_listed(others),
                plot=plotted(figure, 140 + 22 * len(shown), 2, left=240),
                plotly=plotly_script(),
            )
        )
