"""The shape of a force without a name: what it was along the motion, over position and over speed."""

from html import escape

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.verdict.region import Shape

Array = NDArray[np.float64]
WIDTH, HEIGHT, LEFT, BELOW, TOP = 360, 230, 46, 34, 22
DOTS, BINS, FEWEST = 500, 24, 5
"""Dots, bins of the line through their medians, and dots that a bin needs."""


def portrait(shape: Shape) -> str:
    """Two panels as HTML: dots of the motion, and their median."""
    force, unit = ("N m", "rad") if shape.turns else ("N", "m")
    panels = [
        _panel(shape.position, shape.force, f"position of {shape.joint}, {unit}", force),
        _panel(shape.speed, shape.force, f"speed of {shape.joint}, {unit}/s", force),
    ]
    return f'<div class="portrait">{"".join(panels)}</div>'


def _panel(x: Array, y: Array, label: str, unit: str) -> str:
    (left, right), (low, high) = _limits(x), _limits(y)
    across, up = (WIDTH - LEFT) / (right - left), (HEIGHT - BELOW - TOP) / (high - low)

    def place(a: Array, b: Array) -> Array:
        return np.stack([LEFT + (a - left) * across, TOP + (high - b) * up], axis=-1).round(1)

    shown = np.flatnonzero((x >= left) & (x <= right) & (y >= low) & (y <= high))
    some = shown[:: max(1, len(shown) // DOTS)]
    dots = "".join(f'<circle cx="{a:g}" cy="{b:g}" r="1.8"/>' for a, b in place(x[some], y[some]))
    path = " ".join(f"{a:g},{b:g}" for a, b in place(*_medians(x[shown], y[shown])))
    zero = ""
    if low < 0 < high:
        level = float(place(np.zeros(1), np.zeros(1))[0, 1])
        zero = f'<path class="zero" d="M{LEFT} {level:g}H{WIDTH}"/>'
    base = HEIGHT - BELOW
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="Missing force over {escape(label)}">'
        f'<path class="axis" d="M{LEFT} {TOP}V{base}H{WIDTH}"/>{zero}{dots}<polyline class="middle" points="{path}"/>'
        f'<text x="{LEFT - 6}" y="{TOP + 8}" text-anchor="end">{high:.2g}</text>'
        f'<text x="{LEFT - 6}" y="{base}" text-anchor="end">{low:.2g}</text>'
        f'<text x="{LEFT}" y="{base + 15}">{left:.2g}</text>'
        f'<text x="{WIDTH}" y="{base + 15}" text-anchor="end">{right:.2g}</text>'
        f'<text x="{(LEFT + WIDTH) / 2:g}" y="{base + 15}" text-anchor="middle">{escape(label)}</text>'
        f'<text x="{LEFT - 6}" y="{TOP - 10}">force, {unit}</text></svg>'
    ).replace(">-", ">−")


def _limits(values: Array) -> tuple[float, float]:
    """That hold nearly all values."""
    low, high = (float(x) for x in np.quantile(values, [0.002, 0.998]))
    pad = 0.04 * (high - low) or 1.0
    return low - pad, high + pad


def _medians(x: Array, y: Array) -> tuple[Array, Array]:
    """Of equal bins, of the line through the dots, where there are enough."""
    edges = np.linspace(x.min(), x.max(), BINS + 1)
    which = np.clip(np.digitize(x, edges) - 1, 0, BINS - 1)
    full = [b for b in range(BINS) if np.sum(which == b) >= FEWEST]
    middle = (edges[1:] + edges[:-1]) / 2
    return middle[full], np.array([np.median(y[which == b]) for b in full])
