"""The page of a track: one HTML file, which shows the clip beside it."""

import base64
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from PIL import Image
from plotly.subplots import make_subplots
from scipy.special import ellipk

from keycld_control.plain_json import readable
from keycld_control.plots import plotly_script, plotted
from keycld_envs.effects import phrase
from keycld_envs.templates import templates
from keycld_model.tracking import Track
from keycld_model.tracking.pendulum import Study

OVERLAY = "overlay.mp4"
"""The clip with the track drawn over the video, in the folder of the page."""
PINK = "#e0457b"
COLOURS = "#1f6f9f", "#d08a1d", "#4a8f3c", "#7a56b0"
"""Of the angles of one joint after the other."""
PIECE = 320
"""Pixels of the width of a picture in the strip."""


def html_page(track: Track, study: Study | None, numbers: Mapping[str, Any], strip: list[NDArray[np.uint8]]) -> str:
    """The text of report.html.

    Args:
        track: what was followed.
        study: of a free pendulum.
        numbers: by `keycld_control.tracking.summary.summary`.
        strip: [h, w, 3] uint8 pictures with the track drawn over them.
    """
    rows = [
        (name.replace("_", " "), readable(value))
        for name, value in numbers.items()
        if name not in ("candidates", "doubts")
    ]
    plots = [plotted(_angles(track, study), 460)]
    if study is not None:
        plots.append(plotted(_periods(study), 340))
    page = templates("keycld_control.tracking").get_template("report.html")
    return page.render(
        plotly=plotly_script(),
        name=track.film.path.name,
        overlay=OVERLAY,
        verdict=numbers["dissipation"],
        doubts=numbers["doubts"],
        rows=rows,
        candidates=[c | {"effects": ", ".join(map(phrase, c["effects"]))} for c in numbers.get("candidates", [])],
        plots=plots,
        strip=[_picture(image) for image in strip],
    )


def _angles(track: Track, study: Study | None) -> go.Figure:
    figure = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.7, 0.3], vertical_spacing=0.06)
    times = track.film.times
    trusted = np.where(track.trusted, 1.0, np.nan)
    for k, (angle, deviation) in enumerate(zip((track.angles * trusted).T, track.deviation.T, strict=True)):
        colour, group = COLOURS[k % len(COLOURS)], {"mode": "lines", "legendgroup": str(k)}
        figure.add_scatter(x=times, y=angle, name=f"angle {k + 1}", line={"color": colour}, row=1, col=1, **group)
        thin = {"color": colour, "width": 1}
        figure.add_scatter(x=times, y=1e3 * deviation, name="standard deviation", line=thin, row=2, col=1, **group)
    if study is not None:
        later = times >= study.split
        band = {
            "x": np.concatenate([times[later], times[later][::-1]]),
            "y": np.concatenate([study.high[later], study.low[later][::-1]]),
        }
        figure.add_scatter(
            **band, fill="toself", mode="none", fillcolor=PINK, opacity=0.3, name="90 % interval", row=1, col=1
        )
        about = {"name": "predicted from the first part", "mode": "lines", "line": {"color": PINK, "dash": "dot"}}
        figure.add_scatter(x=times[later], y=study.prediction[later], **about, row=1, col=1)
    figure.update_yaxes(title="angle, rad", row=1, col=1)
    figure.update_yaxes(title="mrad", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title="time, s", row=2, col=1)
    return figure


def _periods(study: Study) -> go.Figure:
    figure = go.Figure()
    amplitude = study.swings[:, 1]
    figure.add_scatter(x=amplitude, y=study.swings[:, 2], mode="markers", name="half swings, doubled")
    axis = np.linspace(0, float(amplitude.max()), 60)
    theory = study.period[0] * 2 / np.pi * ellipk(np.sin(axis / 2) ** 2)
    figure.add_scatter(x=axis, y=theory, mode="lines", name="rigid pendulum", line={"color": PINK})
    figure.update_xaxes(title="amplitude, rad", rangemode="tozero")
    figure.update_yaxes(title="period, s")
    return figure


def _picture(image: NDArray[np.uint8]) -> str:
    picture = Image.fromarray(image)
    picture.thumbnail((PIECE, PIECE))
    file = io.BytesIO()
    picture.save(file, "PNG")
    return base64.b64encode(file.getvalue()).decode("ascii")
