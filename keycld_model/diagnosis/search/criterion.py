"""What a fit is worth: its cost, with its parameters paid for."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.autocorrelation import samples_together
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.parameters import effect_parameters
from keycld_model.diagnosis.estimation.replay import mean_square
from keycld_model.diagnosis.inputs.observation import BoundedNoise
from keycld_model.diagnosis.simulation.variant import recording_spreads


@dataclass(frozen=True)
class Scored:
    """A fit, and what it costs with its parameters paid for, nats."""

    fit: Fit
    score: float

    @property
    def size(self) -> tuple[int, int]:
        """How many effects there are, and how many parameters they have."""
        return len(self.keys), len(effect_parameters(self.fit.effects))

    @property
    def keys(self) -> frozenset[tuple[str, str]]:
        """Effects and places."""
        return frozenset(e.key for e in self.fit.effects)

    def improves_on(self, other: "Scored", least: float) -> bool:
        """It gains some nats at least, or loses no more with fewer effects, or as many of fewer parameters."""
        return other.score - self.score >= (-least if self.size < other.size else least)

    @classmethod
    def of(cls, fit: Fit, dispersion: float = 1.0) -> "Scored":
        """A fit, its cost in nats of a dispersion."""
        return cls(fit, fit.cost / dispersion + penalty(fit, dispersion))


def score_of(scored: Scored) -> float:
    """To sort by."""
    return scored.score


def penalty(fit: Fit, dispersion: float = 1.0) -> float:
    """Nats that a set of effects must gain to be worth its parameters.

    Each number costs what it does by Schwarz's criterion (1978); but of effects that have others of nearly the same
    kind, the first only, and the others what the recordings tell of them, see `form_price`. Hidden states at the start
    of a recording fit noise, too, and so do offsets of rotors, by half a nat each; two standard deviations more, for
    the fit is the best of many.
    """
    problem, offsets = fit.problem, fit.point.offsets
    number, price = 0.5 * np.log(problem.samples), 0.0
    for effect in fit.effects:
        further = len(effect.parameters()) - 1
        price += number + (number * further if effect.confusable is None else form_price(fit, effect, dispersion))
    if fit.point.variant.window_offsets is None:
        return price + 0.5 * len(recording_spreads(fit.effects)) * len(problem.windows.commands)
    return price + 0.5 * offsets.size + np.sqrt(2 * offsets.size)


def form_price(fit: Fit, effect: Effect, dispersion: float = 1.0) -> float:
    """Nats that one form of an effect, such as dry friction, must gain over another with a single number.

    The Occam factor of Laplace's approximation (MacKay, 1992): before, a number is as uncertain as the largest of its
    unit in the effect is large, since forms vary by some share of the effect; afterwards, by what recordings tell. A
    number of which they tell nothing costs nothing. What is told best is the effect's size, of which all forms have
    one.
    """
    numbers = effect.parameters()
    away = {p.name: abs(getattr(effect, p.name) - p.absent) for p in numbers}
    before = np.array([max(away[other.name] for other in numbers if other.unit == p.unit) for p in numbers])
    told = before[:, None] * fit.precision(effect) * before / dispersion
    return 0.5 * float(np.sum(np.log1p(np.maximum(np.linalg.eigvalsh(told)[:-1], 0.0))))


def dispersion(fit: Fit) -> float:
    """Variance of what a fit leaves over the sensor's, times the samples that it is correlated over; one for noise.

    The dispersion factor ĉ of a quasi-likelihood (Burnham and Anderson, 2002, section 2.5).
    """
    dof = max(1, fit.problem.samples - 2 * fit.point.q.size - len(fit.hessian))
    left = 2 * fit.cost / dof
    if left < fit.problem.criteria.noise_variance:
        return 1.0
    residual, n = fit.residual, fit.problem.windows.samples
    together = samples_together(lambda lag: np.mean(residual[:, lag:] * residual[:, : n - lag]), n // 2)
    return max(1.0, left) * float(together)


def share_left(fit: Fit) -> NDArray[np.float64]:
    """Share of the noise's variance that a fit leaves, `[m]`, times the samples that it is correlated over."""
    residual, n = fit.residual, fit.problem.windows.samples
    together = samples_together(lambda lag: np.mean(residual[:, lag:] * residual[:, : n - lag], axis=(0, 1)), n // 2)
    return mean_square(fit) * together


def left_of_noise(fit: Fit) -> NDArray[np.float64]:
    """Mean square of what a fit leaves over that of the noise, or of the most that it may be, by channel, `[m]`."""
    observation, left = fit.problem.windows.observation, mean_square(fit)
    return (
        left * (observation.noise / observation.noise_at_most) ** 2 if isinstance(observation, BoundedNoise) else left
    )


def above_noise(fit: Fit) -> NDArray[np.float64]:
    """By how much the mean square of whitened residuals is more than noise, `[m]`; negative where it is not."""
    left, criteria = left_of_noise(fit), fit.problem.criteria
    return left - 1 - criteria.spreads.noise - criteria.significant * np.sqrt(2 / (fit.problem.samples / len(left)))
