"""Several models of the same joints as one."""

import functools
import operator
from collections.abc import Iterable, Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.delan.config import JointConfig
from keycld_model.delan.equations import Equations
from keycld_model.delan.network import Parameters


class Sum(Equations):
    """Torques add, and with them inertias and energies.

    Accelerations follow from all inertias together; what a feed-forward network says of them is added.

    Args:
        config: of the family "sum".
        parts: equations of its parts.
    """

    def __init__(self, config: JointConfig, parts: Sequence[Equations]) -> None:
        super().__init__(config)
        self.parts = {part_name(i): part for i, part in enumerate(parts)}
        self.conserves = all(part.conserves for part in parts)

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Those of the parts."""
        return {name: part.initial(rng) for name, part in self.parts.items()}

    def inverse_dynamics(self, p: Parameters, q: Array, v: Array, a: Array) -> Array:
        """Torques `[n]`."""
        return _total(part.inverse_dynamics(p[name], q, v, a) for name, part in self.parts.items())

    def forward_dynamics(self, p: Parameters, q: Array, v: Array, tau: Array) -> Array:
        """Accelerations `[n]`."""
        mechanics = {name: part for name, part in self.parts.items() if part.conserves}
        bias = _total(part.inverse_dynamics(p[name], q, v, jnp.zeros_like(v)) for name, part in mechanics.items())
        inertias = _total(part.inertias(p[name], q, v) for name, part in mechanics.items())
        networks = [
            part.forward_dynamics(p[name], q, v, tau) for name, part in self.parts.items() if not part.conserves
        ]
        return _total([jnp.linalg.solve(inertias, tau - bias), *networks])

    def mass_matrix(self, p: Parameters, q: Array) -> Array:
        """Inertias `[n, n]` at rest."""
        return _total(part.mass_matrix(p[name], q) for name, part in self.parts.items())

    def inertias(self, p: Parameters, q: Array, v: Array) -> Array:
        """Inertias `[n, n]` in motion."""
        return _total(part.inertias(p[name], q, v) for name, part in self.parts.items())

    def potential_energy(self, p: Parameters, q: Array) -> Array:
        """Energy at rest, J, up to a constant."""
        return _total(part.potential_energy(p[name], q) for name, part in self.parts.items())

    def energy(self, p: Parameters, q: Array, v: Array) -> Array:
        """Kinetic and potential energy, J, up to a constant."""
        return _total(part.energy(p[name], q, v) for name, part in self.parts.items())


def part_name(i: int) -> str:
    """Of the parameters of a part."""
    return f"part_{i}"


def _total(arrays: Iterable[Array]) -> Array:
    return functools.reduce(operator.add, arrays)
