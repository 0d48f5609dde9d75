"""Simulators of real mechanisms, declared: pendulums of one or two links, and MJCF files."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco

from keycld_control.benchmarks.real.fields import built, check_known, inside
from keycld_control.benchmarks.real.parameter_files import numbers_of
from keycld_envs.errors import InputError
from keycld_model.diagnosis import Source

Number = float | str
"""A number, or what it is called in the file with the owners' identified parameters."""
# Steps as large as accuracy allows: the diagnosis also tries the model's own, and walks through them one by one.
_HEAD = """<mujoco><option timestep="{step}" gravity="0 0 {gravity}" integrator="RK4"><flag contact="disable"/></option>
<worldbody>"""


@dataclass(frozen=True)
class Identified:
    """Numbers that the owners identified.

    Attributes:
        path: of their file; see `numbers_of`.
        numbers: by name.
    """

    path: Path | None
    numbers: Mapping[str, float]

    @classmethod
    def read(cls, path: Path | None) -> "Identified":
        """All numbers of a file; none of no file.

        Raises:
            InputError: if the file is missing or damaged.
        """
        return cls(path, {} if path is None else numbers_of(path, ()))

    def __call__(self, number: Number) -> float:
        """A number, looked up if it is a name.

        Raises:
            InputError: if there is none of that name.
        """
        if isinstance(number, str):
            source = "Without the file of a field identified," if self.path is None else f"{self.path}:"
            check_known(f"{source} the number", number, dict(self.numbers))
            return self.numbers[number]
        return number


@dataclass(frozen=True)
class Link:
    """A rigid link about its joint.

    Attributes:
        mass: kg.
        com: distance of its centre of mass from the joint, m.
        inertia: about the joint, kg m².
        rotor: inertia of the motor's rotor, kg m².
        gear: turns of the rotor for one of the joint.
    """

    mass: Number
    com: Number
    inertia: Number
    rotor: Number = 0.0
    gear: Number = 1.0

    def inertial(self, known: Identified) -> str:
        """As MJCF."""
        mass, com, inertia = known(self.mass), known(self.com), known(self.inertia)
        about_com = inertia - mass * com**2
        if about_com <= 0:
            raise InputError(
                f"The inertia of a link, {inertia:g} kg m², is not above mass × com² = {mass * com**2:g}; give it "
                "about the joint."
            )
        return (
            f'<inertial pos="0 0 {-com!r}" mass="{mass!r}" '
            f'diaginertia="{about_com!r} {about_com!r} {about_com / 100!r}"/>'
        )

    def armature(self, known: Identified) -> float:
        """Inertia of the rotor as the joint feels it, kg m²."""
        return known(self.gear) ** 2 * known(self.rotor)


@dataclass(frozen=True)
class Pendulum:
    """One hinge, "hinge".

    Attributes:
        link: what swings.
        motor: with an actuator "motor", N m.
        turned: angle at which it hangs, degrees.
        gravity: m/s².
        identified: file with the owners' parameters, from the folder with the data.
    """

    link: Link
    motor: bool = False
    turned: float = 0.0
    gravity: Number = 9.81
    identified: str | None = None

    def model(self, folder: Path) -> mujoco.MjModel:
        """Compiled."""
        known = Identified.read(None if self.identified is None else folder / self.identified)
        actuator = '<actuator><motor name="motor" joint="hinge"/></actuator>' if self.motor else ""
        return mujoco.MjModel.from_xml_string(
            _HEAD.format(step=0.01, gravity=-known(self.gravity))
            + f'<body name="link" euler="0 {self.turned!r} 0">{self.link.inertial(known)}<joint name="hinge" '
            + f'axis="0 1 0" armature="{self.link.armature(known)!r}"/></body></worldbody>{actuator}</mujoco>'
        )


@dataclass(frozen=True)
class DoublePendulum:
    """Hinges "shoulder" and "elbow", the second relative to the first, each with a motor of its name, N m.

    What the second rotor adds to the coupling of both joints is left out.

    Attributes:
        upper: first link.
        lower: second link.
        length: of the first link, m.
        gravity: m/s².
        identified: file with the owners' parameters, from the folder with the data.
    """

    upper: Link
    lower: Link
    length: Number
    gravity: Number = 9.81
    identified: str | None = None

    def model(self, folder: Path) -> mujoco.MjModel:
        """Compiled."""
        known = Identified.read(None if self.identified is None else folder / self.identified)
        shoulder, elbow = (
            f'{link.inertial(known)}<joint name="{joint}" axis="0 1 0" armature="{link.armature(known)!r}"/>'
            for joint, link in (("shoulder", self.upper), ("elbow", self.lower))
        )
        return mujoco.MjModel.from_xml_string(
            _HEAD.format(step=0.005, gravity=-known(self.gravity))
            + f'<body name="upper">{shoulder}<body name="lower" pos="0 0 {-known(self.length)!r}">{elbow}</body></body>'
            + '</worldbody><actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/>'
            + "</actuator></mujoco>"
        )


@dataclass(frozen=True)
class Mjcf:
    """A MuJoCo XML file.

    Attributes:
        path: from the folder with the data.
    """

    path: str

    def model(self, folder: Path) -> mujoco.MjModel:
        """Compiled."""
        return Source.of_file(folder / self.path).model


KINDS: dict[str, type[Pendulum] | type[DoublePendulum] | type[Mjcf]] = {
    "pendulum": Pendulum,
    "double pendulum": DoublePendulum,
    "mjcf": Mjcf,
}


def simulator(table: Mapping[str, object], where: str) -> Callable[[Path], mujoco.MjModel]:
    """Makes the model, of the folder with the data sets.

    Args:
        table: with the fields of a kind, and `kind`.
        where: file and field, for messages.

    Raises:
        InputError: if a field is wrong.
    """
    own = dict(table)
    kind = own.pop("kind", None)
    check_known(inside(where, "kind"), kind, KINDS)
    return built(KINDS[str(kind)], own, where).model
