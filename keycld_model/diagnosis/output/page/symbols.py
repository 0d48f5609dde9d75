"""Symbols of a mechanism as SVG; all points are in the view box, y down."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def point(centre: Array, radius: float, css: str) -> str:
    """A circle."""
    return f'<circle class="{css}" cx="{centre[0]:.1f}" cy="{centre[1]:.1f}" r="{radius:.1f}"/>'


def arrow(tail: Array, head: Array, css: str) -> str:
    """A straight arrow."""
    return f'<g class="{css}"><path d="M{_at(tail)}L{_at(head)}"/>{_tip(head, head - tail)}</g>'


def motor(centre: Array, along: Array | None, css: str) -> str:
    """A circular arrow around a hinge, or an arrow both ways beside a slide."""
    if along is not None:
        side, reach = np.array([along[1], -along[0]]) * 30, along / np.linalg.norm(along) * 24
        side = side if side[1] < 0 else -side
        a, b = centre + side - reach, centre + side + reach
        return f'<g class="{css}"><path d="M{_at(a)}L{_at(b)}"/>{_tip(a, a - b)}{_tip(b, b - a)}</g>'
    radius, angles = 18.0, np.deg2rad([150, 40])
    start, end = (centre + radius * np.array([np.cos(a), np.sin(a)]) for a in angles)
    tangent = np.array([np.sin(angles[1]), -np.cos(angles[1])]) * -1.0
    path = f'<path d="M{_at(start)}A{radius} {radius} 0 1 1 {_at(end)}"/>'
    return f'<g class="{css}">{path}{_tip(end, tangent)}</g>'


def base(centre: Array, down: float) -> str:
    """A bracket that holds a hinge, below it (down = 1) or above."""
    x, y, h = centre[0], centre[1], 24 * down
    hatches = "".join(f"M{x + i:.1f} {y + h:.1f}l-6 {7 * down:.1f}" for i in (-14, -6, 2, 10, 18))
    bracket = f'<path class="bracket" d="M{x:.1f} {y:.1f}L{x - 13:.1f} {y + h:.1f}H{x + 13:.1f}Z"/>'
    return f'<g class="ground">{bracket}<path d="M{x - 20:.1f} {y + h:.1f}H{x + 20:.1f}"/><path d="{hatches}"/></g>'


def rail(a: Array, b: Array, along: Array) -> str:
    """A rail between the places where a slide has been, and a little beyond."""
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    if float((b - a) @ along) < 0:
        a, b = b, a
    a, b, across = a - 30 * along, b + 30 * along, 7 * np.array([-along[1], along[0]])
    stops = "".join(f"M{_at(p - across)}L{_at(p + across)}" for p in (a, b))
    return f'<g class="rail"><path d="M{_at(a)}L{_at(b)}"/><path d="{stops}"/></g>'


def cart(centre: Array, along: Array) -> str:
    """A carriage on a rail."""
    angle = np.rad2deg(np.arctan2(along[1], along[0]))
    turned = f'transform="translate({centre[0]:.1f} {centre[1]:.1f}) rotate({angle:.1f})"'
    return f'<rect class="cart" x="-27" y="-15" width="54" height="30" rx="7" {turned}/>'


def badge(centre: Array, number: int) -> str:
    """The number of a finding."""
    return (
        f'<g class="badge"><circle cx="{centre[0]:.1f}" cy="{centre[1]:.1f}" r="8"/>'
        f'<text x="{centre[0]:.1f}" y="{centre[1] + 3.8:.1f}">{number}</text></g>'
    )


def _tip(at: Array, direction: Array) -> str:
    """An arrow head."""
    d = direction / max(float(np.linalg.norm(direction)), 1e-9)
    across = np.array([-d[1], d[0]])
    return f'<path class="tip" d="M{_at(at + 3 * d)}L{_at(at - 5 * d + 4 * across)}L{_at(at - 5 * d - 4 * across)}Z"/>'


def _at(p: Array) -> str:
    return f"{p[0]:.1f} {p[1]:.1f}"
