"""The families of joint models, by name: each is one file."""

import jax
import numpy as np
from jax import Array

from keycld_model.delan.black_box import BlackBoxLagrangian
from keycld_model.delan.config import Family, JointConfig
from keycld_model.delan.equations import Equations
from keycld_model.delan.feed_forward import FeedForward
from keycld_model.delan.friction import friction_torque, initial_friction
from keycld_model.delan.hamiltonian import StructuredHamiltonian
from keycld_model.delan.least_squares import LeastSquares
from keycld_model.delan.network import Parameters
from keycld_model.delan.structured import StructuredLagrangian
from keycld_model.delan.sum import Sum

FAMILIES: dict[Family, type[Equations]] = {
    "structured": StructuredLagrangian,
    "black_box": BlackBoxLagrangian,
    "hamiltonian": StructuredHamiltonian,
    "feed_forward": FeedForward,
    "least_squares": LeastSquares,
}


def equations_of(config: JointConfig) -> Equations:
    """Equations of motion of a family, or of a sum."""
    if config.parts:
        return Sum(config, [equations_of(part) for part in config.parts])
    return FAMILIES[config.family](config)


class JointDynamics:
    """Equations of a family with friction at the joints; functions of one sample."""

    def __init__(self, config: JointConfig) -> None:
        self.config, self.equations = config, equations_of(config)

    def initial(self, seed: int) -> Parameters:
        """Parameters to begin training with."""
        rng = np.random.default_rng(seed)
        return {"equations": self.equations.initial(rng), "friction": initial_friction(self.config)}

    def inverse_dynamics(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """Torques `[n]` of motors."""
        return self.equations.inverse_dynamics(p["equations"], q, v, a) + friction_torque(p["friction"], v)

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """Accelerations `[n]` under torques of motors."""
        return self.equations.forward_dynamics(p["equations"], q, v, tau - friction_torque(p["friction"], v))

    def prediction_errors(self, p: Parameters, q: Array, v: Array, a: Array, tau: Array) -> Array:
        """What training makes small, `[k]`, N m or N."""
        friction = friction_torque(p["friction"], v)
        return self.equations.prediction_errors(p["equations"], q, v, a, tau, friction)

    def energy_rate(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """Power that goes into the joint model's energy and its friction, W."""
        energy, equations = self.equations.energy, p["equations"]
        _, rate = jax.jvp(lambda q, v: energy(equations, q, v), (q, v), (v, a))
        return rate + v @ friction_torque(p["friction"], v)
