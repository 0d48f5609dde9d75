"""Mass on a link."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Array, Effect, parameter


@dataclass(frozen=True)
class AddedMass(Effect):
    """A point mass on a link that turns, on the line from its joint through its centre of mass, at l."""

    id: ClassVar[str] = "added_inertia"
    family: ClassVar[str] = "inertia"
    kind: ClassVar = "body"
    equation: ClassVar[str] = "tau = -m*(x*l)^2*qdd - m*g*x*l*sin(q)"

    m: float = parameter("kg", 0.02, low=0.0)
    x: float = parameter("1", 0.1, low=0.2, high=4.0, grid=(1.0, 2.0))

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple["AddedMass", ...]:
        """Every body that turns and is not balanced."""
        hinge = mujoco.mjtJoint.mjJNT_HINGE
        bodies = [b for b in range(1, model.nbody) if model.body_dofnum[b] == 1]
        turning = [b for b in bodies if model.jnt_type[model.body_jntadr[b]] == hinge]
        return tuple(cls(model.body(b).name) for b in turning if np.linalg.norm(_arm(model, b)) > 1e-6)

    def edit(self, model: mujoco.MjModel) -> None:
        """Add to the body's mass, centre and principal moments; exact in the plane of a principal axis."""
        body = int(model.body(self.where).id)
        if self.m == 0:
            return
        arm, mass = _arm(model, body), float(model.body_mass[body])
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[body])
        along = axes.reshape(3, 3).T @ (arm / np.linalg.norm(arm))
        apart = (self.x - 1) * np.linalg.norm(arm)
        model.body_inertia[body] += self.m * mass / (self.m + mass) * apart**2 * (1 - along**2)
        model.body_ipos[body] += self.m / (self.m + mass) * (self.x - 1) * arm
        model.body_mass[body] += self.m


def _arm(model: mujoco.MjModel, body: int) -> Array:
    """From a body's joint to its centre of mass, m."""
    return model.body_ipos[body] - model.jnt_pos[model.body_jntadr[body]]
