"""A page per gate: measured, refitted and corrected, and what is left of each."""

from pathlib import Path

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from keycld_control.benchmarks.real.gate import GateResult
from keycld_envs.files import atomic_file

COLOURS = {"measured": "#222222", "refitted": "#d1495b", "corrected": "#00798c"}


def write_page(result: GateResult, path: Path) -> None:
    """Write a self-contained HTML file; it needs no network."""
    rows = len(result.curves)
    titles = [text for curve in result.curves for text in (curve.title, "measured minus predicted")]
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
    verdict = "passed" if result.passed else "not reached"
    title = f"{result.gate}, {result.title}: {verdict}<br><sub>required: {result.required}</sub>"
    figure.update_layout(title=title, template="plotly_white", height=160 + 260 * rows, margin={"t": 110})
    with atomic_file(path, "w") as file:
        file.write(figure.to_html(include_plotlyjs=True, full_html=True))


def _line(x: object, y: object, name: str, legend: bool) -> go.Scatter:
    return go.Scatter(
        x=x,
        y=y,
        name=name,
        legendgroup=name,
        showlegend=legend,
        mode="lines",
        line={"color": COLOURS[name], "width": 1.5},
    )
