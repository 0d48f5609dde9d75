"""The corrected simulator as an ordinary MJCF file."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from os.path import normpath
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file
from keycld_model.diagnosis.inputs.source import Source
from keycld_model.diagnosis.output.native import Native, native
from keycld_model.diagnosis.output.words import call, spelled_out
from keycld_model.diagnosis.verdict.evidence import Evidence
from keycld_model.rigid_body.equality import anchors, bodies, connections

Element = ElementTree.Element
Model = mujoco.MjModel
COPIED = {
    "body": ("body_pos", "body_quat", "body_mass", "body_ipos", "body_iquat", "body_inertia"),
    "joint": ("jnt_pos", "jnt_axis", "jnt_stiffness", "jnt_stiffnesspoly", "jnt_range"),
    "dof": ("dof_damping", "dof_dampingpoly", "dof_frictionloss", "dof_armature"),
    "position": ("qpos0", "qpos_spring"),
    "actuator": ("actuator_gainprm", "actuator_biasprm", "actuator_gear", "actuator_ctrlrange", "actuator_forcerange"),
}
"""Arrays of a model that must be in the file to the last digit."""


def write_corrected(evidence: Evidence, source: Source, path: Path) -> Native:
    """Write the simulator with nuisances refitted and findings added.

    Effects that MuJoCo has are numbers of the file; others are in a comment at its top.

    Args:
        evidence: of a diagnosis.
        source: of the simulator that was diagnosed.
        path: the file. Its meshes, textures and height fields are copied to a folder beside it, `corrected_assets` for
            `corrected.xml`, and named relative to it, so that the two can be moved together.

    Returns:
        What is in the file, and what is not.

    Raises:
        InputError: if the MJCF is not known, or cannot be written without loss.
    """
    written = native(evidence.refitted, evidence.effects)
    xml, assets = corrected_xml(written, source, f"{path.stem}_assets")
    for name, content in assets.items():
        with atomic_file(path.parent / name) as file:
            file.write(content)
    with atomic_file(path, "w") as file:
        file.write(xml)
    return written


def corrected_xml(written: Native, source: Source, folder: str) -> tuple[str, dict[str, bytes]]:
    """The text of the file, and the assets that it names in a folder beside it; see `write_corrected`."""
    spec, target = source.spec(), written.model
    spec.compiler.inertiafromgeom, spec.compiler.settotalmass = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO, -1
    spec.compiler.balanceinertia, spec.compiler.boundmass, spec.compiler.boundinertia = 0, 0, 0
    spec.option.timestep, spec.option.integrator = target.opt.timestep, target.opt.integrator
    spec.option.gravity, spec.option.disableflags = target.opt.gravity, target.opt.disableflags
    with _explained():
        spec.compile()
    root = ElementTree.fromstring(spec.to_xml())
    assets = _collected(root, source, folder)
    rough = _compiled(ElementTree.tostring(root, encoding="unicode"), assets)
    _options(root, target)
    names = [rough.body(b).name for b in range(rough.nbody)], [target.body(b).name for b in range(target.nbody)]
    if len(names[0]) != len(names[1]) or any(b and a != b for a, b in zip(*names, strict=True)):
        raise InputError(
            "corrected.xml cannot be written: bodies change when the MJCF is written anew; set "
            'fusestatic="false" in its compiler element.'
        )
    for body in root.iter("body"):
        _body(body, rough, target)
        for joint in body.findall("joint"):
            _joint(joint, rough, target)
    for actuator in root.findall("actuator/*"):
        _actuator(actuator, rough, target)
        for name, value in written.actuators.get(str(actuator.get("name")), {}).items():
            actuator.set(name, value)
    _loops(root, rough, target)
    ElementTree.indent(root)
    out = _comment(written) + ElementTree.tostring(root, encoding="unicode") + "\n"
    _verify(_compiled(out, assets), target)
    return out, assets


def _collected(root: Element, source: Source, folder: str) -> dict[str, bytes]:
    """The content of all files that assets refer to, by the new names in a folder that the assets get."""
    compiler, out = root.find("compiler"), {}
    given = {} if compiler is None else compiler.attrib
    folders = {kind: given.pop(kind, "") for kind in ("meshdir", "texturedir")}
    for asset in root.findall("asset/*"):
        for attribute in [name for name in asset.attrib if name.startswith("file")]:
            old = Path(folders["texturedir" if asset.tag == "texture" else "meshdir"], asset.attrib[attribute])
            content, number, new = _content(old, source), 1, f"{folder}/{old.name}"
            while out.setdefault(new, content) != content:  # another file of that name
                number, new = number + 1, f"{folder}/{old.stem}_{number + 1}{old.suffix}"
            asset.set(attribute, new)
    return out


def _content(path: Path, source: Source) -> bytes:
    """The content of a file that the source holds in memory, or of one on disk.

    Raises:
        InputError: if it is in neither.
    """
    held = {normpath(name): content for name, content in source.assets.items()}
    for name in (normpath(path), path.name):
        if name in held:
            return held[name]
    if not path.is_file():
        raise InputError(
            f"corrected.xml cannot be written: {path}, to which the MJCF refers, is no file; put it there."
        )
    return path.read_bytes()


def _compiled(text: str, assets: Mapping[str, bytes]) -> Model:
    """Compile what MuJoCo has written.

    Raises:
        InputError: if MuJoCo does not read it.
    """
    with _explained():
        return mujoco.MjModel.from_xml_string(text, dict(assets))


@contextmanager
def _explained() -> Iterator[None]:
    """Raise an InputError in place of MuJoCo's errors."""
    try:
        yield
    except ValueError as error:
        raise InputError(
            f"corrected.xml cannot be written: {error}; use report.json with the original file."
        ) from error


def _comment(written: Native) -> str:
    lines = ["The corrected simulator, written by keycld diagnose: masses and lengths refitted, missing physics added."]
    lines += ["The time step and the integrator are those that were fitted with."]
    lines += [f"Written in MuJoCo's own numbers: {call(e)}" for e in written.effects]
    rest = [e for e in written.others if not e.observes]
    if any(map(spelled_out, rest)):
        lines += ["Not in this file; add it with keycld_envs.effects.added_physics.AddedPhysics and these effects:"]
        lines += [f"  {call(e)}" for e in rest if spelled_out(e)]
    functions = "Not in this file: a fitted function, in report.evidence.effects of keycld_model.diagnosis.diagnose:"
    lines += [f"{functions} {call(e)}" for e in rest if not spelled_out(e)]
    lines += [f"In the measurement, not in the motion: {call(e)}" for e in written.others if e.observes]
    return "<!--\n" + "".join(f"  {line.replace('--', '- -')}\n" for line in lines) + "-->\n"


def _options(root: Element, target: Model) -> None:
    option = root.find("option")
    if option is None:
        option = ElementTree.SubElement(root, "option")
    option.set("timestep", _text(target.opt.timestep))
    option.set("gravity", _text(target.opt.gravity))


def _body(element: Element, rough: Model, target: Model) -> None:
    """Write where a body is, and its inertia."""
    b = rough.body(str(element.get("name"))).id
    frame = ("body_pos", "body_quat")
    if any(_differs(rough, target, name, b) for name in frame):
        for name in ("axisangle", "xyaxes", "zaxis", "euler"):
            element.attrib.pop(name, None)
        element.set("pos", _text(target.body_pos[b]))
        element.set("quat", _text(target.body_quat[b]))
    if any(_differs(rough, target, name, b) for name in COPIED["body"] if name not in frame):
        for old in element.findall("inertial"):
            element.remove(old)
        inertial = Element("inertial", {"pos": _text(target.body_ipos[b]), "quat": _text(target.body_iquat[b])})
        inertial.set("mass", _text(target.body_mass[b]))
        inertial.set("diaginertia", _text(target.body_inertia[b]))
        element.insert(0, inertial)


def _joint(element: Element, rough: Model, target: Model) -> None:
    joint = target.joint(str(element.get("name")))
    j, dof, q = joint.id, int(joint.dofadr[0]), int(joint.qposadr[0])
    for attribute, index, value in (
        ("pos", j, "jnt_pos"),
        ("axis", j, "jnt_axis"),
        ("range", j, "jnt_range"),
        ("ref", q, "qpos0"),
        ("springref", q, "qpos_spring"),
        ("frictionloss", dof, "dof_frictionloss"),
        ("armature", dof, "dof_armature"),
    ):
        if _differs(rough, target, value, index):
            element.set(attribute, _text(getattr(target, value)[index]))
    for attribute, index, names in (
        ("stiffness", j, ("jnt_stiffness", "jnt_stiffnesspoly")),
        ("damping", dof, ("dof_damping", "dof_dampingpoly")),
    ):
        if any(_differs(rough, target, name, index) for name in names):
            element.set(attribute, _text([getattr(target, names[0])[index], *getattr(target, names[1])[index]]))


def _actuator(element: Element, rough: Model, target: Model) -> None:
    i = target.actuator(str(element.get("name"))).id
    for name in COPIED["actuator"]:
        if _differs(rough, target, name, i):
            element.set(name.removeprefix("actuator_"), _text(getattr(target, name)[i]))
    if _differs(rough, target, "actuator_ctrllimited", i):
        element.set("ctrllimited", "true")


def _loops(root: Element, rough: Model, target: Model) -> None:
    """Write the points that close loops; as sites, where MuJoCo would put them elsewhere."""
    elements = root.findall("equality/*")
    for i in connections(target):
        points = list(zip(bodies(target, i), anchors(target, i), anchors(rough, i), strict=True))
        if all(np.array_equal(new, old) for _, new, old in points):
            continue
        for name in ("body1", "body2", "anchor"):
            elements[i].attrib.pop(name, None)
        for k, (body, point, _) in enumerate(points):
            name = f"loop {i} {k + 1}"
            place = root.find(f".//body[@name='{target.body(body).name}']" if body else "worldbody")
            if place is None:
                raise InputError(
                    f"corrected.xml cannot be written: body {body} of a connection has no name; give it one."
                )
            elements[i].set(f"site{k + 1}", name)
            ElementTree.SubElement(place, "site", {"name": name, "pos": _text(point)})


def _differs(rough: Model, target: Model, name: str, index: int) -> bool:
    return not np.array_equal(getattr(rough, name)[index], getattr(target, name)[index])


def _text(value: float | Sequence[float] | NDArray[np.float64]) -> str:
    """Numbers with every digit, separated by spaces."""
    return " ".join(repr(float(x)) for x in np.atleast_1d(np.asarray(value, dtype=np.float64)))


def _verify(got: Model, target: Model) -> None:
    """Compare what the file compiles to with the model that it should hold.

    Raises:
        InputError: if they differ.
    """
    for name in (name for names in COPIED.values() for name in names):
        a, b = getattr(got, name), getattr(target, name)
        if a.shape != b.shape or not np.allclose(a, b, rtol=1e-12, atol=1e-12):
            raise InputError(
                f"corrected.xml cannot be written: {name} is not what was fitted after the MJCF was written anew; use "
                "the effects of report.json with the original file."
            )
    for i in connections(target):
        if not np.allclose(np.array(anchors(got, i)), np.array(anchors(target, i)), rtol=1e-12, atol=1e-12):
            raise InputError("corrected.xml cannot be written: a loop closes elsewhere; use report.json instead.")
