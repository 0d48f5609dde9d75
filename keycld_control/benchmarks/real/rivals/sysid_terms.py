"""Numbers of a MuJoCo model that are identified."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco

Setting = Callable[[mujoco.MjModel, float], None]
MOST_DELAY = 0.1
"""Of a motor, s."""


@dataclass(frozen=True)
class Term:
    """A number of a model, or of what is measured and commanded.

    Attributes:
        effect: id of the taxonomy that it is the size of.
        where: name of the joint or motor.
        joint: there.
        parameter: name of the effect's number.
        unit: of it.
        start: to search from.
        low: least.
        high: greatest.
        put: sets it in a model; None if it is in what is measured or commanded.
        absent: the effect's number if there is none.
        grows: the effect has no numbers below that.
        of_motor: a factor or delay of what a motor gives.
    """

    effect: str
    where: str
    joint: str
    parameter: str
    unit: str
    start: float
    low: float
    high: float
    put: Setting | None = None
    absent: float = 0.0
    grows: bool = True
    of_motor: bool = False

    @property
    def name(self) -> str:
        """What it is called among the others."""
        return f"{self.effect} at {self.where}"

    def starting(self, value: float) -> "Term":
        """The same, from another value on."""
        return replace(self, start=float(value))


def changeable(model: mujoco.MjModel) -> list[Term]:
    """What may differ between two sets of recordings."""
    out = []
    for j in range(model.njnt):
        joint, dof = model.joint(j).name, int(model.jnt_dofadr[j])
        for effect, parameter, unit, start, high, put in (
            ("viscous_friction", "b", "N m s/rad", 0.01, 2.0, _adding("dof_damping", dof)),
            ("coulomb_friction", "c", "N m", 0.05, 5.0, _adding("dof_frictionloss", dof)),
            ("quadratic_drag", "d", "N m s^2/rad^2", 0.002, 0.5, _adding("dof_dampingpoly", (dof, 0))),
            ("spring", "k", "N m/rad", 0.02, 5.0, _adding("jnt_stiffness", j)),
        ):
            out.append(Term(effect, joint, joint, parameter, unit, start, 0.0, high, put))
    for i in range(model.nu):
        motor, joint = model.actuator(i).name, model.joint(int(model.actuator_trnid[i, 0])).name
        gain = _times("actuator_gainprm", (i, 0))
        out += [
            Term("constant_force", joint, joint, "f", "N m", 0.0, -5.0, 5.0, _bias(i), grows=False),
            Term("actuator_gain", motor, joint, "k", "1", 1.0, 0.2, 3.0, gain, 1.0, grows=False, of_motor=True),
            Term("actuator_delay", motor, joint, "d", "s", 0.002, 0.0, MOST_DELAY, of_motor=True),
        ]
    return out


def fixed(model: mujoco.MjModel) -> list[Term]:
    """What is the same in all recordings: masses with their inertias, rotors, and zeros of encoders."""
    out = []
    for b in range(1, model.nbody):
        name = model.body(b).name
        out.append(Term("added_mass", name, name, "factor", "1", 1.0, 0.5, 2.0, _heavier(b)))
    for j in range(model.njnt):
        name = model.joint(j).name
        rotor = _adding("dof_armature", int(model.jnt_dofadr[j]))
        out.append(Term("added_inertia", name, name, "i", "kg m^2", 0.001, 0.0, 0.1, rotor))
        out.append(Term("encoder_zero", name, name, "zero", "rad", 0.0, -0.2, 0.2))
    return out


def edited(model: mujoco.MjModel, terms: Sequence[Term], values: Mapping[str, float], step: float) -> mujoco.MjModel:
    """A copy of a model with steps of so many seconds and other numbers, by the names of terms."""
    out = copy.copy(model)
    out.opt.timestep = step
    for term in terms:
        if term.put is not None:
            term.put(out, values[term.name])
    mujoco.mj_setConst(out, mujoco.MjData(out))
    return out


def _adding(array: str, index: int | tuple[int, int]) -> Setting:
    def put(model: mujoco.MjModel, value: float) -> None:
        getattr(model, array)[index] += value

    return put


def _times(array: str, index: tuple[int, int]) -> Setting:
    def put(model: mujoco.MjModel, value: float) -> None:
        getattr(model, array)[index] *= value

    return put


def _bias(i: int) -> Setting:
    def put(model: mujoco.MjModel, value: float) -> None:
        model.actuator_biastype[i] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_biasprm[i, 0] += value / model.actuator_gear[i, 0]

    return put


def _heavier(b: int) -> Setting:
    def put(model: mujoco.MjModel, value: float) -> None:
        model.body_mass[b] *= value
        model.body_inertia[b] *= value

    return put
