"""The page of a training, written beside it as it goes on: one HTML file that needs nothing else."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from keycld_control.plots import plotly_script, plotted
from keycld_control.runs.strip import strip
from keycld_envs.files import atomic_file
from keycld_envs.recordings import Dataset
from keycld_envs.templates import templates
from keycld_model import WorldModel
from keycld_model.training import log

NAME = "report.html"
REFRESH_S = 30
"""Seconds after which a browser reads the page of an unfinished training again, and between two pages."""
NO_CURVES = ("step", "seconds", "round")
COLOURS = ("#1f6f9f", "#e0457b", "#3a8f4f", "#d08a1d", "#7a5ab5", "#666")


class TrainingPage:
    """Writes `report.html` beside a run: curves of its log, and what the model sees of a recording that is held out."""

    def __init__(self, folder: Path, title: str, steps: int | None, test: Callable[[], Dataset] | None) -> None:
        """Look on from the beginning.

        Args:
            folder: of the run.
            title: of the page.
            steps: of the whole training, None if it ends by itself.
            test: recordings that are held out, of which the first is shown; None for a joint model.
        """
        self._folder, self._title, self._steps, self._test = folder, title, steps, test
        self._written = -float("inf")

    def logged(self, entry: Mapping[str, Any]) -> None:
        """Curves are read from the log, with those of sessions before."""

    def saved(self, model: WorldModel | None, *, finished: bool) -> None:
        """Write the page, unless it was just written and the training goes on."""
        if not finished and time.perf_counter() - self._written < REFRESH_S:
            return
        entries = list(log.entries(self._folder))
        picture = None
        if model is not None and self._test is not None:
            held_out = self._test()
            picture = strip(model, replace(held_out, recordings=held_out.recordings[:1]), predict=finished)
        text = html_page(self._title, entries, self._steps, finished, picture)
        with atomic_file(self._folder / NAME, "w") as file:
            file.write(text)
        self._written = time.perf_counter()


def html_page(
    title: str, entries: Sequence[Mapping[str, Any]], steps: int | None, finished: bool, picture: str | None = None
) -> str:
    """The text of report.html.

    Args:
        title: of the page.
        entries: lines of the log, in order.
        steps: of the whole training, None if it ends by itself.
        finished: if not, the page asks the browser to read it again.
        picture: of frames, a PNG file in base 64.
    """
    last: dict[str, Any] = {}
    for entry in entries:
        last |= {key: value for key, value in entry.items() if isinstance(value, int | float | str)}
    figure = curves(entries)
    return (
        templates("keycld_control.runs")
        .get_template("report.html")
        .render(
            plotly=plotly_script(),
            title=title,
            refresh=None if finished else REFRESH_S,
            step=last.get("step", 0),
            steps=steps,
            rows=[(name.replace("_", " "), f"{v:.4g}" if isinstance(v, float) else v) for name, v in last.items()],
            curves=None if figure is None else plotted(figure, 120 + 180 * len(figure.layout.annotations)),
            picture=picture,
            predicted=finished,
        )
    )


def curves(entries: Iterable[Mapping[str, Any]]) -> go.Figure | None:
    """A plot for each number in the log, over the steps; stages have their colours."""
    series: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for entry in entries:
        for name, value in entry.items():
            if name not in NO_CURVES and isinstance(value, int | float):
                stage = str(entry.get("stage", entry.get("round", "")))
                series.setdefault(name, {}).setdefault(stage, []).append((entry["step"], value))
    if not series:
        return None
    colours = dict(zip(dict.fromkeys(s for parts in series.values() for s in parts), cycle(COLOURS), strict=False))
    unnamed = set(colours)
    titles = [name.replace("_", " ") for name in series]
    figure = make_subplots(len(series), 1, subplot_titles=titles, shared_xaxes=True, vertical_spacing=0.3 / len(series))
    for row, parts in enumerate(series.values(), 1):
        for stage, points in parts.items():
            steps, values = zip(*points, strict=True)
            about: dict[str, Any] = {"name": stage, "legendgroup": stage, "showlegend": stage in unnamed}
            about["line"] = {"color": colours[stage]}
            unnamed.discard(stage)
            mode = "lines+markers" if len(points) < 10 else "lines"
            figure.add_scatter(x=steps, y=values, mode=mode, row=row, col=1, **about)
        if all(value > 0 for points in parts.values() for _, value in points):
            figure.update_yaxes(type="log", exponentformat="power", row=row, col=1)
    figure.update_xaxes(title="step", row=len(series), col=1)
    return figure
