"""The shape of a residual force: what it was along the motion, over position and over speed."""

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.output.page.elements import Element, element
from keycld_model.diagnosis.verdict.region import Shape

Array = NDArray[np.float64]
WIDTH, HEIGHT, LEFT, BELOW, TOP = 360, 230, 46, 34, 22
DOTS, BINS, FEWEST = 500, 24, 5
"""Dots, bins of the line through their medians, and dots that a bin needs."""


def portrait(shape: Shape) -> list[Element]:
    """Two panels as SVG elements: dots of the motion, and their median."""
    force, unit = ("N m", "rad") if shape.turns else ("N", "m")
    return [
        _panel(shape.position, shape.force, f"position of {shape.joint}, {unit}", force),
        _panel(shape.speed, shape.force, f"speed of {shape.joint}, {unit}/s", force),
    ]


def _panel(x: Array, y: Array, label: str, unit: str) -> Element:
    (left, right), (low, high) = _limits(x), _limits(y)
    across, up = (WIDTH - LEFT) / (right - left), (HEIGHT - BELOW - TOP) / (high - low)

    def place(a: Array, b: Array) -> Array:
        return np.stack([LEFT + (a - left) * across, TOP + (high - b) * up], axis=-1).round(1)

    shown = np.flatnonzero((x >= left) & (x <= right) & (y >= low) & (y <= high))
    some = shown[:: max(1, len(shown) // DOTS)]
    base, middle = HEIGHT - BELOW, place(*_medians(x[shown], y[shown]))
    out = [element("path", class_="axis", d=f"M{LEFT} {TOP}V{base}H{WIDTH}")]
    if low < 0 < high:
        level = float(place(np.zeros(1), np.zeros(1))[0, 1])
        out.append(element("path", class_="zero", d=f"M{LEFT} {level:g}H{WIDTH}"))
    out += [element("circle", cx=a, cy=b, r=1.8) for a, b in place(x[some], y[some])]
    out.append(element("polyline", class_="middle", points=" ".join(f"{a:g},{b:g}" for a, b in middle)))
    out += [
        _text(_number(high), LEFT - 6, TOP + 8, "end"),
        _text(_number(low), LEFT - 6, base, "end"),
        _text(_number(left), LEFT, base + 15, "start"),
        _text(_number(right), WIDTH, base + 15, "end"),
        _text(label, (LEFT + WIDTH) / 2, base + 15, "middle"),
        _text(f"force, {unit}", LEFT - 6, TOP - 10, "start"),
    ]
    return element("svg", *out, viewBox=f"0 0 {WIDTH} {HEIGHT}", role="img", aria_label=f"Missing force over {label}")


def _text(text: str, x: float, y: float, anchor: str) -> Element:
    return element("text", text, x=x, y=y, text_anchor=anchor)


def _number(value: float) -> str:
    return f"{value:.2g}".replace("-", "−")


def _limits(values: Array) -> tuple[float, float]:
    """An interval that holds nearly all values."""
    low, high = (float(x) for x in np.quantile(values, [0.002, 0.998]))
    pad = 0.04 * (high - low) or 1.0
    return low - pad, high + pad


def _medians(x: Array, y: Array) -> tuple[Array, Array]:
    """The middles of equal bins along x that hold enough dots, and the medians of y in them."""
    edges = np.linspace(x.min(), x.max(), BINS + 1)
    which = np.clip(np.digitize(x, edges) - 1, 0, BINS - 1)
    full = [b for b in range(BINS) if np.sum(which == b) >= FEWEST]
    middle = (edges[1:] + edges[:-1]) / 2
    return middle[full], np.array([np.median(y[which == b]) for b in full])
