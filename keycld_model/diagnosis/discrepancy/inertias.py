"""Masses, centres of mass, inertias and lengths of links, and rotors: numbers in which every simulator is a little off.

Some simulators are off by a factor. What is linear in masses is fitted well from there, but not what follows from them:
motors would push a link of half its weight twice as fast. Such a simulator gets the masses of the recordings first.
"""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.delan.rig import ALL_LINKS, OWN_ERROR, deviation, learned_dynamics
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.discrepancy.motion import Motion, inverse_dynamics

Array = NDArray[np.float64]
DIFFERENCE = 0.02
"""Share of an inertia, by which it is changed for its column."""
FACTOR = 2.0
"""By which a number is corrected at once at most."""


@dataclass(frozen=True)
class Inertial:
    """A number of a link, or of the rotor at a joint.

    Attributes:
        name: for instance "mass of upper_arm".
        field: of `mujoco.MjModel`.
        rows: of the field.
        spread: standard deviation expected of it: relative, of rotors in kg m² or kg.
    """

    name: str
    field: str
    rows: Sequence[int]
    spread: float

    @property
    def of_rotor(self) -> bool:
        """Whether it adds up, from zero, in place of being multiplied."""
        return self.field == "dof_armature"

    @property
    def of_learning(self) -> bool:
        """Whether it is an own error of a joint model, which adds up, too, with any sign."""
        return self.field == "body_user"

    def change(self, model: mujoco.MjModel, by: float) -> None:
        """Change it in a model, by a share of itself; of rotors by kg m² or kg, of own errors by their unit."""
        if self.of_learning:
            deviation(model)[self.rows] += by
            return
        numbers, rows = getattr(model, self.field), list(self.rows)
        if self.of_rotor:
            numbers[rows] = np.maximum(numbers[rows] + by, 0.0)
        else:
            numbers[rows] *= 1 + by


def inertials(model: mujoco.MjModel, criteria: Criteria) -> Iterator[Inertial]:
    """All that are not zero, and rotors; of a joint model, the common factor of its links, and its own errors."""
    spread = criteria.spreads.mass_beside_forces
    learned = learned_dynamics(model) is not None
    if learned:
        yield Inertial(f"mass of {ALL_LINKS}", "body_mass", [int(model.body(ALL_LINKS).id)], spread)
        for k in range(len(deviation(model))):
            yield Inertial(f"{OWN_ERROR} {k + 1}", "body_user", [k], criteria.spreads.mass)
    for body in () if learned else np.flatnonzero(model.body_dofnum):
        children = np.flatnonzero(model.body_parentid == body)
        numbers = {
            "mass": ("body_mass", [body], 1.0),
            "centre of mass": ("body_ipos", [body], 0.25),
            "inertia": ("body_inertia", [body], 2.0),
            "length": ("body_pos", children, 0.25),
        }
        for name, (field, rows, times) in numbers.items():
            if np.any(getattr(model, field)[rows]):
                yield Inertial(f"{name} of {model.body(body).name}", field, rows, times * spread)
    for dof in range(model.nv):
        name = f"rotor at {model.joint(int(model.dof_jntid[dof])).name}"
        yield Inertial(name, "dof_armature", [dof], spread * float(model.dof_M0[dof]))


def inertial_columns(motion: Motion, criteria: Criteria, held: bool) -> list[tuple[str, Array, float]]:
    """Name, column `[W, r]` per unit, and spread of each.

    Accelerations are known no better than unknown forces are small, so that least squares would take masses away until
    little is left to explain. What forces of inertia have in common may therefore be held at the simulator's: the term
    that most changes it makes up for what the others change of it, and accelerations are what is explained.

    Args:
        motion: along which they act.
        criteria: what is expected of them.
        held: what forces of inertia have in common is held at the simulator's.
    """
    forces, inertial = _needed(motion, motion.model)
    out: list[tuple[str, Array, Array, float]] = []
    for number in inertials(motion.model, criteria):
        if number.of_rotor:
            column = motion.answer(np.where(np.arange(motion.model.nv) == number.rows[0], -motion.a, 0.0))
            out.append((number.name, column, column, number.spread))
            continue
        after = copy.copy(motion.model)
        number.change(after, DIFFERENCE)
        now, now_inertial = _needed(motion, after)
        fall = motion.answer((forces - now) / DIFFERENCE), motion.answer((inertial - now_inertial) / DIFFERENCE)
        out.append((number.name, *fall, number.spread))
    if not held:
        return [(name, column, spread) for name, column, _, spread in out]
    whole = motion.answer(inertial)
    share = np.array([np.sum(own * whole) for _, _, own, _ in out]) / np.sum(whole**2)
    most = int(np.argmax(np.abs(share) * [spread for *_, spread in out]))
    made_up = out[most][1] / share[most]
    return [(name, column - share[i] * made_up, spread) for i, (name, column, _, spread) in enumerate(out) if i != most]


def with_own_masses(
    motion: Motion, values: Mapping[str, float], criteria: Criteria, near: float
) -> mujoco.MjModel | None:
    """The simulator with what was found of its inertial numbers; None if its own are near enough, or larger.

    Noise of accelerations takes masses away, and never adds to them, so that masses that fall are not believed.

    Args:
        motion: along which forces are compared.
        values: of the numbers, by their names.
        criteria: what is expected of them.
        near: share of the simulator's forces at a joint that may be needed beyond them.
    """
    after = copy.copy(motion.model)
    for number in inertials(motion.model, criteria):
        value = values.get(number.name, 0.0)
        adds = number.of_rotor or number.of_learning
        number.change(after, value if adds else float(np.clip(value, 1 / FACTOR - 1, FACTOR - 1)))
    mujoco.mj_setConst(after, mujoco.MjData(after))
    before, now = (np.sqrt(np.mean(_needed(motion, m)[0] ** 2, axis=(0, 1))) for m in (motion.model, after))
    return after if np.any(now > (1 + near) * before) else None


def _needed(motion: Motion, model: mujoco.MjModel) -> tuple[Array, Array]:
    """Forces `[W, S, nv]` that the motion needs, and of these the forces of inertia."""
    forces = inverse_dynamics(model, motion.q, motion.v, motion.a)
    return forces, forces - inverse_dynamics(model, motion.q, motion.v, np.zeros_like(motion.a))
