"""How the plant differs from the simulator without anything missing: masses and lengths within 20 per cent."""

from dataclasses import dataclass

import mujoco
import numpy as np

WITHIN = 0.2
"""Greatest relative error."""


@dataclass(frozen=True)
class ParameterErrors:
    """By how much masses and lengths of the plant differ from the simulator's: factors by body.

    Attributes:
        mass: of mass and inertia of each body that moves by a joint of its own, and of what is fixed to it.
        length: of the distances of centres of mass and of children, where that joint is a hinge; inertia goes with its
            square.
    """

    mass: dict[str, float]
    length: dict[str, float]

    def apply(self, model: mujoco.MjModel) -> None:
        """Change a compiled model in place."""
        for name, factor in self.mass.items():
            for body in _fixed(model, model.body(name).id):
                model.body_mass[body] *= factor
                model.body_inertia[body] *= factor
        for name, factor in self.length.items():
            top = model.body(name).id
            bodies = _fixed(model, top)
            for body in bodies:
                model.body_ipos[body] *= factor
                model.body_inertia[body] *= factor**2
            for body in range(1, model.nbody):
                if body != top and int(model.body_parentid[body]) in bodies:
                    model.body_pos[body] *= factor


def draw_errors(model: mujoco.MjModel, rng: np.random.Generator) -> ParameterErrors:
    """Independent factors, uniform within 20 per cent."""
    mass, length = {}, {}
    for joint in range(model.njnt):
        name = model.body(int(model.jnt_bodyid[joint])).name
        mass[name] = float(rng.uniform(1 - WITHIN, 1 + WITHIN))
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            length[name] = float(rng.uniform(1 - WITHIN, 1 + WITHIN))
    return ParameterErrors(mass, length)


def _fixed(model: mujoco.MjModel, top: int) -> set[int]:
    """The body and what is fixed to it, over any number of welds; parents come before children."""
    bodies = {top}
    for body in range(top + 1, model.nbody):
        if int(model.body_parentid[body]) in bodies and model.body_jntnum[body] == 0:
            bodies.add(body)
    return bodies
