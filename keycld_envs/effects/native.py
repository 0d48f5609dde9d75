"""A model that has effects in its own numbers."""

from dataclasses import dataclass, field

import mujoco


@dataclass
class NativeModel:
    """A model while effects are written into it, as far as MuJoCo has them itself.

    Attributes:
        model: compiled.
        gains: factors of the torques of actuators, by name.
        attributes: of actuators by name, which change the size of a model's state, so that only its XML can have them.
    """

    model: mujoco.MjModel
    gains: dict[str, float] = field(default_factory=dict)
    attributes: dict[str, dict[str, str]] = field(default_factory=dict)

    @property
    def stages(self) -> bool:
        """The stages of a Runge-Kutta step look half a step ahead on average."""
        return self.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
