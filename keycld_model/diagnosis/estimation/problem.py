"""Windows of recordings, and how well a simulator explains them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import huber

from keycld_envs.effects import Effect
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.estimation.belief import Belief
from keycld_model.diagnosis.estimation.linearisation import Linearisation
from keycld_model.diagnosis.estimation.parameters import effect_parameters, with_parameter
from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.inputs.observation import Nuisance
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.simulation.variant import Variant, recording_spreads

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """Windows of recordings, and what may explain them.

    Attributes:
        simulator: of the mechanism.
        windows: of the recordings.
        belief: what is known of nuisances and parameters of effects from other recordings; None for the nuisances'
            spreads.
    """

    simulator: Simulator
    windows: Windows
    belief: Belief | None = None

    @property
    def criteria(self) -> Criteria:
        """Thresholds and priors, of the simulator."""
        return self.simulator.criteria

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Of the simulator, then of the sensor."""
        return (*self.simulator.nuisances, *self.windows.observation.nuisances)

    @cached_property
    def spreads(self) -> Array:
        """Prior standard deviations of the nuisances."""
        return np.array([n.spread for n in self.nuisances])

    @property
    def noise(self) -> Array:
        """`[m]` standard deviation of each channel."""
        return self.windows.observation.noise

    @cached_property
    def inverse_noise(self) -> Array:
        """`[W, n, m]` one over the standard deviation of each sample."""
        return self.windows.weight / self.noise

    @cached_property
    def samples(self) -> int:
        """How many numbers were measured."""
        return int(np.isfinite(self.windows.measured).sum())

    @property
    def expected(self) -> float:
        """Nats that noise alone costs, with initial states fitted."""
        return 0.5 * (self.samples - 2 * self.simulator.model.nv * len(self.windows))

    def start(self) -> Point:
        """The simulator as believed, from measured initial states."""
        return Point(Variant(np.zeros(len(self.nuisances))), *self.windows.initial_states())

    def take(self, index: NDArray[np.int64]) -> "Problem":
        """Some of the windows."""
        return replace(self, windows=self.windows.take(index))

    def predict(
        self, variants: Sequence[Variant], which: NDArray[np.int64], q: Array, v: Array, pushes: Array | None = None
    ) -> Array:
        """What the sensor shows of rollouts, `[P, W, n, m]`; NaN where one diverges. See `Simulator.at_samples`."""
        motions = zip(*self.simulator.at_samples(variants, which, self.windows, q, v, pushes), strict=True)
        return np.stack([self._shown(variants[i], *motion) for i, motion in zip(which, motions, strict=True)])

    def _shown(self, variant: Variant, q: Array, v: Array) -> Array:
        """What the sensor shows of a motion, `[W, n, m]`."""
        return self.windows.observation.predict(q, v, variant.values[len(self.simulator.nuisances) :])

    def predicted(self, point: Point) -> Array:
        """What the sensor shows at a point, `[W, n, m]`."""
        return self.predict([point.variant], np.zeros(1, np.int64), point.q[None], point.v[None])[0]

    def path(self, point: Point) -> tuple[Array, Array, Array]:
        """Positions and velocities `[W, S + 1, nv]` at the steps, and commands that arrive, `[W, S, nu]`."""
        one = np.zeros(1, np.int64)
        q, v, u = self.simulator.roll([point.variant], one, self.windows, point.q[None], point.v[None])
        return q[0], v[0], u[0]

    def whiten(self, predicted: Array) -> Array:
        """Residuals `[..., W, r]` over noise, of predictions `[..., W, n, m]`."""
        diverged = 1e5  # standard deviations that a rollout which diverges is off, and any other at most
        deviation = (self.windows.measured - predicted) * self.inverse_noise
        deviation = np.where(np.isfinite(predicted), deviation, diverged)
        deviation = np.where(np.isfinite(self.windows.measured), deviation, 0.0)
        return np.clip(deviation, -diverged, diverged).reshape(*predicted.shape[:-2], -1)

    def residual(self, *points: Point) -> Array:
        """Whitened residuals `[..., W, r]` of one or more points whose variants differ in offsets of rotors alone."""
        q, v = np.stack([p.q for p in points]), np.stack([p.v for p in points])
        variants = [p.variant for p in points] if points[0].variant.window_offsets is not None else [points[0].variant]
        predicted = self.predict(variants, np.arange(len(points)) % len(variants), q, v)
        return self.whiten(predicted[0] if len(points) == 1 else predicted)

    def costs(self, point: Point) -> Array:
        """Nats of each window, `[W]`; deviations from outliers grow linearly (Huber, 1964)."""
        return huber(self.criteria.significant, self.residual(point)).sum(axis=-1) + point.offset_costs()

    def cost(self, point: Point) -> float:
        """Minus the logarithm of the posterior, nats up to a constant."""
        return float(self.costs(point).sum()) + self.prior(point)

    def prior(self, point: Point) -> float:
        """Nats of nuisances, of parameters known from elsewhere, and of hidden states at the starts of recordings."""
        offsets = point.variant.recording_offsets
        hidden = 0.0 if offsets is None else offsets / recording_spreads(point.effects)
        if self.belief is not None:
            return self.belief.cost(point.variant) + 0.5 * float(np.sum(hidden**2))
        return 0.5 * float(np.sum((point.variant.values / self.spreads) ** 2) + np.sum(hidden**2))

    def linearise(
        self, point: Point, extra: Sequence[tuple[Effect, ...]] = (), only_states: bool = False
    ) -> tuple[Linearisation, Array]:
        """Residuals and derivatives at a point, by finite differences.

        Args:
            point: where.
            extra: sets of effects, to be predicted from the same nuisances and initial states.
            only_states: leave the derivatives to nuisances and parameters of effects at zero.

        Returns:
            The linearisation, and whitened residuals `[len(extra), W, r]` with the extra effects.
        """
        base, recordings, spreads = point.variant, len(self.windows.commands), point.fitted_recording_spreads
        shared_steps = [] if only_states else self._steps(point)
        hidden = []
        for m, spread in enumerate(spreads):
            offsets = point.recording_offsets(recordings)
            offsets[:, m] += 0.1 * spread
            hidden.append(replace(base, recording_offsets=offsets))
        variants = [base, *(variant for _, _, beside in shared_steps for variant in beside), *hidden]
        others = [base.with_effects(*effects) for effects in extra]
        residuals, states, of_sensor = self._roll([*variants, *others], point)
        here, numbers = residuals[0], len(self.nuisances) + len(effect_parameters(base.effects))
        shared = np.zeros((*here.shape, numbers + recordings * len(spreads)))
        moved = iter(residuals[1:])
        for column, width, beside in shared_steps:
            after = next(moved)
            shared[..., column] = ((next(moved) if len(beside) > 1 else here) - after) / width
        for m, (spread, there) in enumerate(zip(spreads, moved, strict=False)):
            at = numbers + self.windows.recording * len(spreads) + m
            shared[np.arange(len(here)), :, at] = (here - there) / (0.1 * spread)
        if not only_states:
            shared[..., len(self.simulator.nuisances) : len(self.nuisances)] = of_sensor
        return Linearisation(here, states, shared), residuals[len(variants) :]

    def _steps(self, point: Point) -> list[tuple[int, float, list[Variant]]]:
        """Column and width of each finite difference to a nuisance of the simulator, or a parameter.

        And the variants that it is of: the one after the step, and the one before unless that is the point's own.
        """
        base, effects = point.variant, point.effects
        out = [(i, n.step, [_moved(base, i, n.step)]) for i, n in enumerate(self.simulator.nuisances)]
        for k, parameter in enumerate(effect_parameters(effects)):
            width, values = parameter.difference(effects)
            beside = [replace(base, effects=with_parameter(effects, parameter, x)) for x in values]
            out.append((len(self.nuisances) + k, width, beside))
        return out

    def linearise_states(self, point: Point) -> tuple[Array, Array]:
        """Residuals `[W, r]`, and minus their derivative to initial states and offsets, `[W, r, 2 nv + J]`."""
        residuals, states, _ = self._roll([point.variant], point)
        return residuals[0], states

    def _roll(self, variants: Sequence[Variant], point: Point) -> tuple[Array, Array, Array]:
        """Residuals `[V, W, r]` at the point's states, and what minus the first ones change with.

        Returns:
            The residuals, and minus the derivatives of the first to states and offsets, `[W, r, 2 nv + J]`, and to
            nuisances of the sensor, `[W, r, k]`; these need no other motion.
        """
        nv, known, offsets = point.q.shape[1], len(variants), variants[0].window_offsets
        spreads = point.offset_spreads
        position_step, velocity_step, offset_steps = 1e-4, 1e-3, 1e-3 * spreads  # rad or m, per s, standard deviations
        moved = [replace(variants[0], window_offsets=offsets + row) for row in np.diag(offset_steps)]
        which = np.concatenate([np.arange(known), np.zeros(2 * nv, int), known + np.arange(len(moved))])
        q, v = (np.repeat(z[None], len(which), axis=0) for z in (point.q, point.v))
        for j in range(nv):
            q[known + j, :, j] += position_step
            v[known + nv + j, :, j] += velocity_step
        every = [*variants, *moved]
        motions = list(zip(*self.simulator.at_samples(every, which, self.windows, q, v), strict=True))
        shown = [self._shown(every[i], *motion) for i, motion in zip(which, motions, strict=True)]
        residuals = self.whiten(np.stack(shown))
        steps = np.concatenate([np.repeat([position_step, velocity_step], nv), offset_steps])[:, None, None]
        states = (residuals[0] - residuals[known:]) / steps
        of_sensor = np.zeros((*residuals.shape[1:], len(self.windows.observation.nuisances)))
        for k, nuisance in enumerate(self.windows.observation.nuisances):
            other = _moved(variants[0], len(self.simulator.nuisances) + k, nuisance.step)
            of_sensor[..., k] = (residuals[0] - self.whiten(self._shown(other, *motions[0]))) / nuisance.step
        return residuals[:known], np.moveaxis(states, 0, -1), of_sensor


def _moved(variant: Variant, nuisance: int, step: float) -> Variant:
    """A variant with another value of a nuisance."""
    values = variant.values.copy()
    values[nuisance] += step
    return replace(variant, values=values)
