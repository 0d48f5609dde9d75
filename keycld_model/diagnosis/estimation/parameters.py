"""The parameters of several effects in a row."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect, Parameter
from keycld_envs.effects.transmission import TransmissionEffect

STEP, ROTOR_STEP = 0.005, 0.001
"""Steps of finite differences, in halves of a parameter's value, or tenths of its scale if that is more: above the
tolerance of MuJoCo's solver, and short beside the kinks of dry friction (of .02 to .002, .005 led to the best fit)."""


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

    def difference(self, effects: Sequence[Effect]) -> tuple[float, list[float]]:
        """Width of a finite difference, and the values that it is of: one after, and one before, or the value itself.

        One-sided differences would not do: where an effect explains much, their error is larger than what is left, so
        that passive motion would seem to tell the scale of all masses. To rotors, which swing fast, steps are so short
        that one side is enough. Near a bound the step is to the other side.
        """
        value, (low, high) = self.of(effects), (self.parameter.low, self.parameter.high)
        rotor = isinstance(effects[self.effect], TransmissionEffect)
        step = (ROTOR_STEP if rotor else STEP) * max(0.1 * self.parameter.scale, abs(value) * 0.5)
        after, before = value + step, value - step
        if after > high:
            return -step, [before]
        if rotor or before <= low:
            return step, [after]
        return 2 * step, [after, before]


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
