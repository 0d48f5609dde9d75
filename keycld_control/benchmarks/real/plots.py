"""A page per gate: measured, refitted and corrected, and what is left of each."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from markupsafe import escape
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from keycld_control.benchmarks.real.gate import GateResult
from keycld_control.plots import plotly_script, plotted
from keycld_envs.files import atomic_file
from keycld_envs.templates import templates

COLOURS = {"measured": "#222222", "refitted": "#d1495b", "corrected": "#00798c"}


def write_page(result: GateResult, path: Path) -> None:
    """Write a self-contained HTML file; it needs no network."""
    rows = len(result.curves)
    titles = [text for curve in result.curves for text in (str(escape(curve.title)), "measured minus predicted")]
    figure = make_subplots(
        rows=rows, cols=2, subplot_titles=titles, shared_xaxes=True, vertical_spacing=0.3 / max(rows, 2)
    )
    for row, curve in enumerate(result.curves, 1):
        figure.add_trace(_line(curve.time, curve.measured, "measured", row == 1), row, 1)
        for name, predicted in curve.predicted.items():
            figure.add_trace(_line(curve.time, predicted, name, row == 1), row, 1)
            figure.add_trace(_line(curve.time, curve.measured - predicted, name, False), row, 2)
        figure.update_yaxes(title_text=curve.unit, row=row)
    figure.update_xaxes(title_text="s", row=rows)
    plot = plotted(figure, 110 + 260 * rows, 2)
    page = templates("keycld_control.benchmarks.real").get_template("gate.html")
    with atomic_file(path, "w") as file:
        file.write(page.render(result=result, plot=plot, plotly=plotly_script()))


def _line(x: NDArray[np.float64], y: NDArray[np.float64], name: str, legend: bool) -> go.Scatter:
    return go.Scatter(
        x=x,
        y=y,
        name=name,
        legendgroup=name,
        showlegend=legend,
        mode="lines",
        line={"color": COLOURS[name], "width": 1.5},
    )
