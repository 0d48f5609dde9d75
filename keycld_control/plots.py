"""How plots in pages look: the same everywhere, and readable on a phone."""

import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

COLUMN = 260
"""Least width of a plot, px; a page that is narrower scrolls what lies beside it into view."""
TITLE, AXIS = 28, 44
"""Room for the titles of subplots above them, and for the axis below, px."""


def plotly_script() -> Markup:
    """The text of plotly.js, once for a page, which then needs no network."""
    return Markup(get_plotlyjs())


def plotted(figure: go.Figure, height: int, columns: int = 1, left: int = 56) -> Markup:
    """A figure as part of a page that has plotly.js; its legend is above it, where it takes no width.

    Args:
        figure: whose layout is completed.
        height: of the whole, px.
        columns: subplots beside each other.
        left: room for names on the vertical axis, px.
    """
    figure.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": left, "r": 12, "t": 2 * TITLE, "b": AXIS},
        legend={"orientation": "h", "x": 0, "y": 1 + TITLE / (height - 2 * TITLE - AXIS), "yanchor": "bottom"},
    )
    html = figure.to_html(include_plotlyjs=False, full_html=False, config={"responsive": True})
    width = f"min-width: {COLUMN * columns}px"
    return Markup('<div style="overflow-x: auto"><div style="{}">{}</div></div>').format(width, Markup(html))
