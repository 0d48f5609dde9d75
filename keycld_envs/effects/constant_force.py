"""A constant force at a joint."""

from dataclasses import dataclass
from typing import ClassVar

from keycld_envs.effects.base import Array, parameter
from keycld_envs.effects.functions import functions
from keycld_envs.effects.places import JointEffect


@dataclass(frozen=True)
class ConstantForce(JointEffect):
    """A bias of the motor, or a weight on a string."""

    id: ClassVar[str] = "constant_force"
    family: ClassVar[str] = "force"
    equation: ClassVar[str] = "tau = f"
    phrase: ClassVar[str] = "a constant force"

    f: float = parameter("N m", 0.02)

    def torque(self, t: Array, q: Array, v: Array) -> Array:
        """The same always."""
        return functions(v).full_like(v, self.f)
