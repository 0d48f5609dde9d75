"""Words beside a drawing, in a column, with lines to what they are about."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.output.page.elements import Element, element
from keycld_model.diagnosis.output.page.symbols import badge, words

Array = NDArray[np.float64]
COLUMN = 300.0
"""Where the column begins, in units of the view box."""
LINE = 16.0
"""Height of a line of text, in units of the view box."""
LETTER = 7.6
"""Width of a letter, on average, in units of the view box."""


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
        """The height of all its lines, in units of the view box."""
        return LINE * (bool(self.title) + bool(self.note) + sum(1 + bool(m.value) for m in self.marks)) + 10

    @property
    def right(self) -> float:
        """Where its longest line ends, in units of the view box."""
        indented = [text for mark in self.marks for text in (mark.title, mark.value)]
        return COLUMN + max(
            [18 + LETTER * len(x) for x in (self.title, self.note)] + [37 + LETTER * len(x) for x in indented]
        )


def column(labels: list[Label], height: float) -> tuple[list[Element], float]:
    """Labels from top to bottom without overlap, with lines to what they are about, and the height that they need."""
    labels = sorted(labels, key=lambda one: one.anchor[1] if one.anchor is not None else np.inf)
    tops, floor = [], 8.0
    for label in labels:
        wanted = floor if label.anchor is None else label.anchor[1] - LINE * 0.6
        tops.append(max(floor, wanted))
        floor = tops[-1] + label.height
    bottom = limit = max(height, 8.0 + sum(label.height for label in labels))
    for i in reversed(range(len(labels))):
        limit = tops[i] = min(tops[i], limit - labels[i].height)
    return [drawn for label, top in zip(labels, tops, strict=True) for drawn in _drawn(label, top)], bottom


def _drawn(label: Label, top: float) -> list[Element]:
    """The words of a label, whose first line begins at `top`, and the line to what it is about."""
    out, y, x = [], top + LINE * 0.75, COLUMN + 18
    if label.anchor is not None:
        css = "leader found" if label.marks else "leader"
        line = f"M{label.anchor[0]:.1f} {label.anchor[1]:.1f}L{COLUMN + 2:.1f} {y - 4:.1f}H{x - 5:.1f}"
        out.append(element("path", class_=css, d=line))
    for text, css in ((label.title, "name"), (label.note, "note")):
        if text:
            out.append(words(text, x, y, css))
            y += LINE
    for mark in label.marks:
        out += [badge(np.array([x + 7, y - 4]), mark.number), words(mark.title, x + 19, y, "what")]
        y += LINE
        if mark.value:
            out.append(words(mark.value, x + 19, y, "value"))
            y += LINE
    return out
