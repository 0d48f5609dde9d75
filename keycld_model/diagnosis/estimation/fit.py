"""What a minimisation ends with."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.diagnosis.estimation.parameters import effect_parameters
from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.estimation.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """The best point that was found.

    Attributes:
        problem: what was fitted.
        point: nuisances, effects and initial states.
        cost: nats, see `Problem.cost`.
        hessian: `[p, p]` of what windows share, initial states eliminated.
    """

    problem: Problem
    point: Point
    cost: float
    hessian: Array

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Physics that was added."""
        return self.point.effects

    @cached_property
    def chi_square(self) -> float:
        """Mean square of the whitened residuals per degree of freedom; one if only noise is left."""
        used = self.point.q.size * 2 + len(self.hessian) + self.point.offsets.size
        return float(np.sum(self.residual**2) / max(1, self.problem.samples - used))

    @cached_property
    def excess(self) -> float:
        """Nats above what noise alone costs."""
        return self.cost - self.problem.expected

    @cached_property
    def residual(self) -> Array:
        """Whitened residuals by sample and channel, `[W, n, m]`."""
        return self.problem.residual(self.point).reshape(self.problem.windows.measured.shape)

    @property
    def covariance(self) -> Array:
        """`[p, p]` of what windows share (Laplace's approximation)."""
        return np.asarray(np.linalg.pinv(self.hessian), np.float64)

    def worth(self, effect: Effect) -> float:
        """Nats that the fit would lose without one of its effects, were it linear in its parameters."""
        away = np.array([getattr(effect, p.name) - p.absent for p in effect.parameters()])
        away[[bool(p.grid) for p in effect.parameters()]] = 0.0
        return 0.5 * float(away @ self.precision(effect) @ away)

    def precision(self, effect: Effect) -> Array:
        """`[k, k]` inverse covariance of the parameters of one of its effects, whatever all others are."""
        numbers = enumerate(effect_parameters(self.effects))
        at = [len(self.problem.spreads) + i for i, p in numbers if self.effects[p.effect] is effect]
        return np.asarray(np.linalg.pinv(self.covariance[np.ix_(at, at)]), np.float64)

    def deviations(self) -> Array:
        """Standard deviations of the effects' parameters, in their order."""
        n = len(self.problem.spreads)
        return np.sqrt(np.maximum(np.diag(self.covariance)[n : n + len(effect_parameters(self.effects))], 0))
