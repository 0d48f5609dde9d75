"""Gravity that does not point down."""

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from keycld_envs.effects.base import Kind, parameter
from keycld_envs.effects.places import WorldEffect


@dataclass(frozen=True)
class GravityTilt(WorldEffect):
    """A base that is not level: gravity turned about the y axis, the normal of the plane of motion."""

    id: ClassVar[str] = "gravity_tilt"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "g = |g|*(sin(alpha), 0, -cos(alpha))"
    phrase: ClassVar[str] = "a gravity tilt"

    alpha: float = parameter("rad", 0.01)

    def indistinguishable(self, model: mujoco.MjModel) -> tuple[tuple[str, Kind, str], ...]:
        """The zero of the encoder of a single hinge: the same, but for what is expected of encoders."""
        if model.njnt == 1 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_HINGE:
            return (("encoder_zero", "joint", model.joint(0).name),)
        return ()

    def edit(self, model: mujoco.MjModel) -> None:
        """Turn gravity."""
        x, y, z = model.opt.gravity
        c, s = np.cos(self.alpha), np.sin(self.alpha)
        model.opt.gravity[:] = c * x - s * z, y, s * x + c * z
