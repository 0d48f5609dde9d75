"""The parameters of several effects in a row."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect, Parameter
from keycld_envs.effects.transmission import TransmissionEffect


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of one of several effects.

    Attributes:
        effect: index of the effect.
        parameter: what is known of it.
    """

    effect: int
    parameter: Parameter

    def of(self, effects: Sequence[Effect]) -> float:
        """Its value."""
        return float(getattr(effects[self.effect], self.parameter.name))

    def beside(self, effects: Sequence[Effect]) -> tuple[float, float]:
        """Two values for a finite difference, to both sides, or the value itself where a bound is near.

        One-sided differences would not do: where an effect explains much, their error is larger than what is left, so
        that passive motion would seem to tell the scale of all masses. Rotors swing fast; to them steps are so short
        that one side is enough.
        """
        value, (low, high) = self.of(effects), (self.parameter.low, self.parameter.high)
        size = max(0.1 * self.parameter.scale, abs(value) * 0.5)
        if isinstance(effects[self.effect], TransmissionEffect):
            step = 0.001 * size
            return (value, value + step) if value + step <= high else (value - step, value)
        step = 0.005 * size
        return value - step if value - step > low else value, value + step if value + step <= high else value


def effect_parameters(effects: Sequence[Effect]) -> list[EffectParameter]:
    """All parameters of effects, in order."""
    return [EffectParameter(i, p) for i, effect in enumerate(effects) for p in effect.parameters()]


def with_parameter(effects: Sequence[Effect], parameter: EffectParameter, value: float) -> tuple[Effect, ...]:
    """The effects with one parameter set."""
    name = parameter.parameter.name
    return tuple(replace(e, **{name: value}) if i == parameter.effect else e for i, e in enumerate(effects))


def moved(effects: Sequence[Effect], step: NDArray[np.float64]) -> tuple[tuple[Effect, ...], NDArray[np.float64]]:
    """The effects after a step of all their parameters, within their bounds; and the step that was taken."""
    out, taken = tuple(effects), step.copy()
    for k, parameter in enumerate(effect_parameters(effects)):
        old = parameter.of(out)
        new = float(np.clip(old + step[k], parameter.parameter.low, parameter.parameter.high))
        taken[k] = new - old
        out = with_parameter(out, parameter, new)
    return out, taken
