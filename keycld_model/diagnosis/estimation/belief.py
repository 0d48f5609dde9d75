"""What recordings tell of nuisances and of parameters of effects, taken along to other recordings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.estimation.parameters import effect_parameters
from keycld_model.diagnosis.simulation.variant import Variant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Belief:
    """A Gaussian over k numbers: nuisances, then parameters of effects (Laplace's approximation).

    Recordings may leave much open, such as the common factor of masses and forces where commands are weak. Others that
    are driven then correct it, which speaks for no effect.

    Attributes:
        mean: `[k]`.
        precision: `[k, k]` inverse of the covariance.
    """

    mean: Array
    precision: Array

    @classmethod
    def of(cls, variant: Variant, hessian: Array) -> "Belief":
        """Around a variant; what is only of its own recordings is left out.

        Args:
            variant: what was fitted.
            hessian: `[p, p]` of all that windows share, nuisances and parameters first.
        """
        mean = _numbers(variant)
        return cls(mean, _without_others(hessian, len(mean)))

    def away(self, variant: Variant) -> Array:
        """`[k]` how far a variant is from the mean."""
        return _numbers(variant) - self.mean

    def cost(self, variant: Variant) -> float:
        """Nats that a variant costs."""
        away = self.away(variant)
        return 0.5 * float(away @ self.precision @ away)

    def narrowed(self, hessian: Array) -> float:
        """Nats: logarithm of the share of its volume that is left with other recordings, whose `hessian` is `[p, p]`.

        The Hessian includes this belief. With it, the cost of the best point is that of the evidence (MacKay, 1992).
        """
        k = len(self.mean)
        both = self.precision, _without_others(hessian, k)
        scale = 1 / np.sqrt(np.maximum(np.diag(both[1]), 1e-300))
        ridge = 1e-12 * np.eye(k)  # directions of which neither tells anything do not count
        before, after = (np.linalg.slogdet(scale[:, None] * m * scale + ridge)[1] for m in both)
        return 0.5 * float(before - after)


def _numbers(variant: Variant) -> Array:
    """`[k]` nuisances, then parameters of effects."""
    effects = variant.effects
    return np.concatenate([variant.values, [parameter.of(effects) for parameter in effect_parameters(effects)]])


def _without_others(hessian: Array, k: int) -> Array:
    """`[k, k]` of the first k numbers, the others fitted."""
    cross, others = hessian[:k, k:], hessian[k:, k:]
    return np.asarray(hessian[:k, :k] - cross @ np.linalg.pinv(others) @ cross.T, np.float64)
