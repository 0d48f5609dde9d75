"""Elements of SVG and MathML."""

from xml.etree import ElementTree

from markupsafe import Markup

Element = ElementTree.Element


def element(tag: str, *children: Element | str, **attributes: str | float) -> Element:
    """An element of a tree, which is escaped when it is written.

    Args:
        tag: its name.
        children: what it holds; text only as the first of them.
        attributes: by name, with `_` for `-`, and `class_` for `class`; of numbers, two digits after the point.
    """
    out = Element(tag)
    for name, value in attributes.items():
        shown = value if isinstance(value, str) else f"{round(float(value), 2) + 0.0:g}"
        out.set(name.rstrip("_").replace("_", "-"), shown)
    for i, child in enumerate(children):
        if not isinstance(child, str):
            out.append(child)
        elif i == 0:
            out.text = child
        else:
            raise ValueError(f"The text {child!r} of <{tag}> is not its first child.")
    return out


def markup(root: Element) -> Markup:
    """A tree as it stands in a page."""
    return Markup(ElementTree.tostring(root, encoding="unicode"))
