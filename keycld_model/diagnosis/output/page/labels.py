"""Words beside a drawing, in a column, with lines to what they are about."""

from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.output.page.symbols import badge

Array = NDArray[np.float64]
COLUMN = 300.0
"""Where the column begins, in units of the view box."""
LINE = 16.0


@dataclass(frozen=True)
class Mark:
    """A finding to show.

    Attributes:
        number: with which text refers to it.
        kind: of the place.
        name: of the place.
        title: what it is.
        value: how large it is.
    """

    number: int
    kind: str
    name: str
    title: str
    value: str


@dataclass
class Label:
    """Words in the column, and the point that they are about."""

    anchor: Array | None
    title: str
    note: str = ""
    marks: list[Mark] = field(default_factory=list)

    @property
    def height(self) -> float:
        """In units of the view box."""
        return LINE * (bool(self.title) + bool(self.note) + sum(1 + bool(m.value) for m in self.marks)) + 10


def column(labels: list[Label], height: float) -> tuple[str, float]:
    """Words from top to bottom without overlap, with lines to what they are about, and the height that they need."""
    labels = sorted(labels, key=lambda one: one.anchor[1] if one.anchor is not None else np.inf)
    tops, floor = [], 8.0
    for label in labels:
        wanted = floor if label.anchor is None else label.anchor[1] - LINE * 0.6
        tops.append(max(floor, wanted))
        floor = tops[-1] + label.height
    bottom = limit = max(height, 8.0 + sum(label.height for label in labels))
    for i in reversed(range(len(labels))):
        limit = tops[i] = min(tops[i], limit - labels[i].height)
    return "".join(_words(label, top) for label, top in zip(labels, tops, strict=True)), bottom


def _words(label: Label, top: float) -> str:
    out, y, x = [], top + LINE * 0.75, COLUMN + 18
    if label.anchor is not None:
        css = "leader found" if label.marks else "leader"
        knee = COLUMN + 2
        out.append(
            f'<path class="{css}" d="M{label.anchor[0]:.1f} {label.anchor[1]:.1f}L{knee:.1f} {y - 4:.1f}H{x - 5:.1f}"/>'
        )
    for text, css in ((label.title, "name"), (label.note, "note")):
        if text:
            out.append(f'<text class="{css}" x="{x:.0f}" y="{y:.1f}">{escape(text)}</text>')
            y += LINE
    for mark in label.marks:
        out.append(badge(np.array([x + 7, y - 4]), mark.number))
        out.append(f'<text class="what" x="{x + 19:.0f}" y="{y:.1f}">{escape(mark.title)}</text>')
        y += LINE
        if mark.value:
            out.append(f'<text class="value" x="{x + 19:.0f}" y="{y:.1f}">{escape(mark.value)}</text>')
            y += LINE
    return "".join(out)
