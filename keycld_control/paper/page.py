"""The self-contained page, and the Markdown file."""

import base64
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, cycle
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.subplots import make_subplots

from keycld_control.paper.aims import aims
from keycld_control.paper.plan import AMOUNTS, TITLES, WHOLE
from keycld_control.paper.tables import (
    Result,
    Table,
    actions,
    amounts,
    chaos,
    chosen,
    integrators,
    long,
    measured,
    potential,
    recall,
    sooner,
    starts,
    states,
    swing_ups,
    vpt,
    with_measure,
)
from keycld_control.plots import plotly_script, plotted
from keycld_envs.files import atomic_file
from keycld_envs.templates import templates

TITLE = "KeyCLD: the paper anew"
COLOURS = ("#1f6f9f", "#d08a1d", "#5b8a3a", "#b23a48", "#7b5aa6", "#555555")


@dataclass(frozen=True)
class Picture:
    """What stands below a table.

    Attributes:
        title: above it.
        plot: of Plotly, as HTML.
        images: captions, and PNG files in base 64.
    """

    title: str
    plot: Markup | None = None
    images: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Section:
    """A table, and the pictures that belong to it, which are drawn when they are asked for."""

    table: Table
    pictures: Iterable[Picture] = ()


def write_report(out: Path, results: Sequence[Result]) -> None:
    """Write report.html and report.md from what has been measured so far."""
    made = [section for section in sections(out, results) if section.table.rows]
    with atomic_file(out / "report.html", "w") as file:
        file.write(html_page(_number(results), made))
    with atomic_file(out / "report.md", "w") as file:
        file.write(f"# {TITLE}\n\n" + "\n".join(section.table.markdown() for section in made))


def html_page(measured: str, sections: Sequence[Section], title: str = TITLE, command: str = "keycld paper") -> str:
    """The text of report.html.

    Args:
        measured: how much was measured, in words.
        sections: from top to bottom.
        title: of the page.
        command: that writes it.
    """
    page = templates("keycld_control.paper").get_template("report.html")
    return page.render(plotly=plotly_script(), measured=measured, sections=sections, title=title, command=command)


def sections(out: Path, results: Sequence[Result]) -> Iterator[Section]:
    """What was to be reached beside what was, then all measures; the paper's figures stand with their tables."""
    yield Section(aims(results))
    yield Section(vpt(results), chain(_curves(results), _strips(out, results)))
    yield Section(starts(results))
    yield Section(amounts(results), _amounts(results))
    yield Section(actions(results))
    yield Section(long(results))
    yield Section(chaos(results))
    yield Section(recall(results), _memories(results))
    yield Section(potential(results), _potentials(results))
    yield Section(states(results))
    yield Section(integrators(results))
    yield Section(swing_ups(results), _swing_ups(out, results))
    yield Section(sooner(results))


def _curves(results: Sequence[Result]) -> Iterator[Picture]:
    if all("failure" in r for r in results):
        return
    systems, named = measured(results), set[str]()
    figure = make_subplots(1, len(systems), subplot_titles=systems, shared_yaxes=True)
    for c, system in enumerate(systems, 1):
        for colour, preset in zip(cycle(COLOURS), TITLES, strict=False):
            found = [r for r in chosen(results, system, preset) if "curve" in r]
            if not found:
                continue
            curve, group = found[0]["curve"], {"legendgroup": preset, "line": {"color": colour}}
            frames = list(range(len(curve["mean"])))
            band = {"x": frames + frames[::-1], "y": curve["high"] + curve["low"][::-1]}
            figure.add_scatter(
                **band, fill="toself", opacity=0.15, hoverinfo="skip", showlegend=False, mode="none",
                fillcolor=colour, legendgroup=preset, row=1, col=c,
            )  # fmt: skip
            first = preset not in named
            named.add(preset)
            figure.add_scatter(x=frames, y=curve["mean"], name=TITLES[preset], showlegend=first, **group, row=1, col=c)
            figure.add_hline(y=curve["epsilon"], line={"dash": "dot", "color": "#999"}, row=1, col=c)  # pyright: ignore
    figure.update_yaxes(type="log", exponentformat="power")
    figure.update_yaxes(title="mean squared error", col=1)
    figure.update_xaxes(title="frame")
    yield figure_of("Error of predicted frames over time, first seed (figure 3)", figure, 420, len(systems))


def _amounts(results: Sequence[Result]) -> Iterator[Picture]:
    if all(r["sequences"] == WHOLE for r in results):
        return
    figure = go.Figure()
    for colour, system in zip(cycle(COLOURS), measured(results), strict=False):
        points = [
            (amount, [r["table"]["vpt_from_5"] for r in chosen(results, system, "default", amount) if "table" in r])
            for amount in (*AMOUNTS, WHOLE)
        ]
        x, y = [a for a, scores in points if scores], [float(np.mean(scores)) for _, scores in points if scores]
        figure.add_scatter(x=x, y=y, name=system, mode="lines+markers", line={"color": colour})
    figure.update_xaxes(type="log", title="sequences", tickvals=[*AMOUNTS, WHOLE])
    figure.update_yaxes(title="VPT from five frames", rangemode="tozero")
    yield figure_of("Valid prediction time by number of training sequences", figure)


def _potentials(results: Sequence[Result]) -> Iterator[Picture]:
    sweeps = [
        (system, sweep) for system, found in with_measure(results, "potential") for sweep in found[0]["potential"]
    ]
    titles = [
        f"{system}, {sweep['title']}" + ("" if sweep["figure"] is None else f" (figure {sweep['figure']})")
        for system, sweep in sweeps
    ]
    figure = make_subplots((len(sweeps) + 1) // 2, 2, subplot_titles=titles)
    for i, (_, sweep) in enumerate(sweeps):
        at = {"row": i // 2 + 1, "col": i % 2 + 1}
        figure.add_scatter(
            x=sweep["position"], y=sweep["true"], name="true", line={"color": "#999", "dash": "dot"},
            showlegend=i == 0, legendgroup="true", **at,
        )  # fmt: skip
        figure.add_scatter(
            x=sweep["position"], y=sweep["learned"], name="learned", line={"color": COLOURS[0]},
            showlegend=i == 0, legendgroup="learned", **at,
        )  # fmt: skip
    figure.update_yaxes(title="J")
    yield figure_of("Potential energy, first seed (figures 8 to 12)", figure, 260 * ((len(sweeps) + 1) // 2), 2)


def _memories(results: Sequence[Result]) -> Iterator[Picture]:
    measured = [(system, found[0]["memory"]) for system, found in with_measure(results, "memory")]
    figure = make_subplots(1, len(measured), subplot_titles=[system for system, _ in measured])
    for c, (_, memory) in enumerate(measured, 1):
        about = {"mode": "markers", "marker": {"color": COLOURS[0]}, "showlegend": False, "row": 1, "col": c}
        figure.add_scatter(x=memory["distance"], y=memory["error"], **about)
    figure.update_xaxes(title="distance", rangemode="tozero")
    figure.update_yaxes(type="log", exponentformat="power")
    figure.update_yaxes(title="mean squared error", col=1)
    title = "Error of test recordings against their distance to training recordings, first seed"
    yield figure_of(title, figure, columns=len(measured))


def _swing_ups(out: Path, results: Sequence[Result]) -> Iterator[Picture]:
    pictures = [
        (f"{system}-default-{r['seed']}-swing-up", f"{system}: from hanging to where it stays; last, the target image")
        for system in measured(results)
        for r in chosen(results, system, "default")[:1]
    ]
    return _pictures("Swing-up (figure 5)", out, pictures)


def _strips(out: Path, results: Sequence[Result]) -> Iterator[Picture]:
    about = "every fourth frame; truth above, prediction below"
    pictures = [
        (f"{system}-{preset}-{r['seed']}", f"{system}, {TITLES[preset]}: {about}")
        for system in measured(results)
        for preset in TITLES
        for r in chosen(results, system, preset)[:1]
    ]
    return _pictures("Frames (figures 4, 13 to 15)", out, pictures)


def _pictures(title: str, out: Path, pictures: Sequence[tuple[str, str]]) -> Iterator[Picture]:
    """Images out of names and captions, as far as their files are there."""
    there = [(path, caption) for name, caption in pictures if (path := out / "strips" / f"{name}.png").is_file()]
    if there:
        images = ((caption, base64.b64encode(path.read_bytes()).decode("ascii")) for path, caption in there)
        yield Picture(title, images=tuple(images))


def figure_of(title: str, figure: go.Figure, height: int = 360, columns: int = 1) -> Picture:
    """A plot below a table, so many px high, with so many subplots beside each other."""
    return Picture(title, plotted(figure, height, columns))


def _number(results: Sequence[Result]) -> str:
    """How much was measured."""
    failed = sum("failure" in r for r in results)
    parts = [_counted(len({r["seed"] for r in results}), "seed")]
    parts += [f"{_counted(failed, 'training')} failed"] if failed else []
    return f"{_counted(len(results), 'model')} measured: {', '.join(parts)}"


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' if number != 1 else ''}"
