"""Explicit edits of an MJCF document in memory, and what to say of one that MuJoCo refuses."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from keycld_envs.errors import InputError
from keycld_envs.reading import JSON_SHARE, check_file

_ASSETS = Path(__file__).parent / "assets"
_COMMON = ("visual", "skybox", "materials")
SHORTEST_STEP, LONGEST_STEP = 1e-5, 0.1
"""Seconds; a shorter step takes hours for what a recording shows, in a longer one no mechanism moves as it should."""


class EditError(RuntimeError):
    """An edit does not fit the document, for instance after a change in dm_control."""


@dataclass(frozen=True)
class Change:
    """Change attributes of the one element at `path`.

    Attributes:
        path: ElementTree path below the root, for instance "worldbody/geom[@name='floor']".
        attributes: name -> (value expected now, value wanted); None stands for an absent attribute.
    """

    path: str
    attributes: Mapping[str, tuple[str | None, str | None]]

    def apply(self, root: ElementTree.Element) -> None:
        """Edit `root` in place.

        Raises:
            EditError: if not exactly one element matches, or an attribute is not as expected.
        """
        element = _find_one(root, self.path)
        for name, (expected, wanted) in self.attributes.items():
            if element.get(name) != expected:
                raise EditError(f"{self.path} has {name}={element.get(name)!r}, expected {expected!r}.")
            if wanted is None:
                del element.attrib[name]
            else:
                element.set(name, wanted)


@dataclass(frozen=True)
class Insert:
    """Insert a new element below the one element at `path`.

    Attributes:
        path: ElementTree path of the parent.
        tag: tag of the new element.
        attributes: its attributes.
        index: position among the parent's children; the default appends.
    """

    path: str
    tag: str
    attributes: Mapping[str, str] = field(default_factory=dict)
    index: int | None = None

    def apply(self, root: ElementTree.Element) -> None:
        """Edit `root` in place.

        Raises:
            EditError: if not exactly one parent matches, or it already has such an element of that name.
        """
        parent = _find_one(root, self.path)
        name = self.attributes.get("name")
        if name is not None and any(child.get("name") == name for child in parent.findall(self.tag)):
            raise EditError(f"{self.path} already has a {self.tag} named {name!r}.")
        parent.insert(
            len(parent) if self.index is None else self.index, ElementTree.Element(self.tag, dict(self.attributes))
        )


def edit(xml: str, *edits: Change | Insert) -> str:
    """Return the MJCF document `xml` with every edit applied in order.

    Raises:
        EditError: if an edit does not find what it expects.
    """
    root = ElementTree.fromstring(xml)
    for each in edits:
        each.apply(root)
    return ElementTree.tostring(root, encoding="unicode")


def read_suite(domain: str) -> tuple[str, dict[str, bytes]]:
    """The MJCF and assets of a dm_control suite domain, as `dm_control.suite.<domain>.get_model_and_assets()`.

    Read from copies in this package: dm_control does not install on every Python, and opens an OpenGL display when
    its suite is imported.
    """
    assets = {f"./common/{name}.xml": (_ASSETS / "common" / f"{name}.xml").read_bytes() for name in _COMMON}
    return (_ASSETS / f"{domain}.xml").read_text(encoding="utf-8"), assets


def check_document(path: Path) -> None:
    """Refuse the path of an MJCF document that is no file, of which MuJoCo says other things.

    Raises:
        InputError: if there is none, or it is a folder, no regular file, or too large.
    """
    try:
        check_file(path, JSON_SHARE)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path} cannot be read ({why}); hand in a MuJoCo XML file.") from error


def refused(name: str, error: Exception) -> InputError:
    """The error to raise for an MJCF document that MuJoCo refuses, in one sentence.

    Args:
        name: what to call the document, for instance its path.
        error: MuJoCo's, which has several lines.
    """
    reason = " ".join(str(error).split()).rstrip(".")
    if not reason.startswith("XML parse error"):
        return InputError(f"{name} does not compile: {reason}; mend the document.")
    line = re.search(r"Line number=([1-9]\d*)", reason)
    where = f" from line {line[1]} on" if line else ""
    return InputError(f"{name} is no XML{where}; hand in a MuJoCo XML file (MJCF).")


def check_step(name: str, model: mujoco.MjModel) -> None:
    """Refuse a time step that no simulation can be made with.

    Raises:
        InputError: if it is not between `SHORTEST_STEP` and `LONGEST_STEP`.
    """
    step = float(model.opt.timestep)
    if not SHORTEST_STEP <= step <= LONGEST_STEP:
        raise InputError(
            f"{name} has a time step of {step:g} s; write one between {SHORTEST_STEP:g} and {LONGEST_STEP:g} s, "
            '<option timestep="0.002"/>.'
        )


def _find_one(root: ElementTree.Element, path: str) -> ElementTree.Element:
    found = root.findall(path)
    if len(found) != 1:
        raise EditError(f"{len(found)} elements match {path!r}, expected one.")
    return found[0]
