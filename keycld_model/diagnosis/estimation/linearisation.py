"""Whitened residuals and their derivatives, with initial states eliminated."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Linearisation:
    """Whitened residuals of W windows, and their derivatives.

    Attributes:
        residual: `[W, r]` measured minus predicted over noise; zero where missing.
        states: `[W, r, 2 nv + J]` minus its derivative to initial positions, velocities, and offsets of rotors.
        shared: `[W, r, p]` the same to nuisances, then parameters of effects, then offsets at starts of recordings.
    """

    residual: Array
    states: Array
    shared: Array

    @cached_property
    def basis(self) -> Array:
        """`[W, r, 2 nv + J]` orthonormal: what initial states can explain."""
        return np.linalg.qr(self.states)[0]

    def huber_weights(self, outlier: float) -> Array:
        """`[W, r]` weights of rows, less than one from so many standard deviations on (Huber, 1964)."""
        return np.sqrt(np.minimum(1.0, outlier / np.maximum(np.abs(self.residual), 1e-9)))

    def weighted(self, weights: Array) -> "Linearisation":
        """With rows weighted, `[W, r]`."""
        column = weights[..., None]
        return Linearisation(self.residual * weights, self.states * column, self.shared * column)

    def with_prior(self, offsets: Array, spreads: Array) -> "Linearisation":
        """With J rows more, which hold offsets `[W, J]` near zero."""
        (w, r, n), j, p = self.states.shape, len(spreads), self.shared.shape[2]
        states = np.concatenate([self.states, np.zeros((w, j, n))], axis=1)
        states[:, r:, n - j :] = np.diag(1 / spreads)
        shared = np.concatenate([self.shared, np.zeros((w, j, p))], axis=1)
        return Linearisation(np.concatenate([self.residual, -offsets / spreads], axis=1), states, shared)

    def project(self, columns: Array) -> Array:
        """What initial states cannot explain of columns `[W, r, k]`."""
        return columns - self.basis @ (np.swapaxes(self.basis, 1, 2) @ columns)
