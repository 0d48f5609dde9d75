"""Symbols of a mechanism as SVG; all points are in the view box, y down."""

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.output.page.elements import Element, element

Array = NDArray[np.float64]


def line(a: Array, b: Array, css: str, width: float) -> Element:
    """A straight line."""
    return element("line", class_=css, x1=a[0], y1=a[1], x2=b[0], y2=b[1], stroke_width=width)


def point(centre: Array, radius: float, css: str) -> Element:
    """A circle."""
    return element("circle", class_=css, cx=centre[0], cy=centre[1], r=radius)


def words(text: str, x: float, y: float, css: str) -> Element:
    """Text that begins at a point."""
    return element("text", text, class_=css, x=x, y=y)


def arrow(tail: Array, head: Array, css: str) -> Element:
    """A straight arrow."""
    return element("g", element("path", d=f"M{_at(tail)}L{_at(head)}"), _tip(head, head - tail), class_=css)


def motor(centre: Array, along: Array | None, css: str) -> Element:
    """A circular arrow around a hinge, or an arrow both ways beside a slide that moves `along` a direction."""
    if along is not None:
        side, reach = np.array([along[1], -along[0]]) * 30, along / np.linalg.norm(along) * 24
        side = side if side[1] < 0 else -side
        a, b = centre + side - reach, centre + side + reach
        return element("g", element("path", d=f"M{_at(a)}L{_at(b)}"), _tip(a, a - b), _tip(b, b - a), class_=css)
    radius, angles = 18.0, np.deg2rad([150, 40])
    start, end = (centre + radius * np.array([np.cos(a), np.sin(a)]) for a in angles)
    tangent = np.array([np.sin(angles[1]), -np.cos(angles[1])]) * -1.0
    turn = element("path", d=f"M{_at(start)}A{radius} {radius} 0 1 1 {_at(end)}")
    return element("g", turn, _tip(end, tangent), class_=css)


def base(centre: Array, down: float) -> Element:
    """A bracket that holds a hinge, below it (down = 1) or above (down = -1)."""
    x, y, h = centre[0], centre[1], 24 * down
    hatches = "".join(f"M{x + i:.1f} {y + h:.1f}l-6 {7 * down:.1f}" for i in (-14, -6, 2, 10, 18))
    return element(
        "g",
        element("path", class_="bracket", d=f"M{x:.1f} {y:.1f}L{x - 13:.1f} {y + h:.1f}H{x + 13:.1f}Z"),
        element("path", d=f"M{x - 20:.1f} {y + h:.1f}H{x + 20:.1f}"),
        element("path", d=hatches),
        class_="ground",
    )


def rail(a: Array, b: Array, along: Array) -> Element:
    """A rail between the places where a slide has been, and a little beyond."""
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    if float((b - a) @ along) < 0:
        a, b = b, a
    a, b, across = a - 30 * along, b + 30 * along, 7 * np.array([-along[1], along[0]])
    ends = "".join(f"M{_at(p - across)}L{_at(p + across)}" for p in (a, b))
    return element("g", element("path", d=f"M{_at(a)}L{_at(b)}"), element("path", d=ends), class_="rail")


def cart(centre: Array, along: Array) -> Element:
    """A carriage on a rail."""
    angle = np.rad2deg(np.arctan2(along[1], along[0]))
    turned = f"translate({_at(centre)}) rotate({angle:.1f})"
    return element("rect", class_="cart", x=-27, y=-15, width=54, height=30, rx=7, transform=turned)


def badge(centre: Array, number: int) -> Element:
    """The number of a finding."""
    disc = element("circle", cx=centre[0], cy=centre[1], r=8)
    return element("g", disc, element("text", str(number), x=centre[0], y=centre[1] + 3.8), class_="badge")


def _tip(at: Array, direction: Array) -> Element:
    """The head of an arrow."""
    d = direction / max(float(np.linalg.norm(direction)), 1e-9)
    across = np.array([-d[1], d[0]])
    outline = f"M{_at(at + 3 * d)}L{_at(at - 5 * d + 4 * across)}L{_at(at - 5 * d - 4 * across)}Z"
    return element("path", class_="tip", d=outline)


def _at(p: Array) -> str:
    """A point in the data of a path."""
    return f"{p[0]:.1f} {p[1]:.1f}"
