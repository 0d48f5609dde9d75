"""Held-out recordings, in windows and in long rollouts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from keycld_envs.recordings import Recording
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.replay import freed, predict, replay
from keycld_model.diagnosis.inputs.windows import cut


@dataclass(frozen=True)
class HeldOut:
    """Where fits are tested.

    Attributes:
        windows: as long as those of the training recordings.
        rollouts: several times as long, as far as recordings go.
    """

    windows: Problem
    rollouts: Problem
    _rolled: list[tuple[Fit, Fit]] = field(default_factory=list, repr=False)
    _predicted: list[tuple[Fit, Fit]] = field(default_factory=list, repr=False)

    @classmethod
    def of(cls, recordings: Sequence[Recording], fit: Fit) -> "HeldOut":
        """Recordings in windows, for the simulator and the sensor of a fit."""
        problem, observation = fit.problem, fit.problem.windows.observation
        samples, criteria = problem.windows.samples, problem.criteria
        shortest = min(int(np.isfinite(observation.measured(r)).any(axis=1).sum()) for r in recordings)
        horizon = max(1, min(criteria.sizes.rollout, shortest // samples))
        short, long = (cut(recordings, observation, problem.simulator.step, n) for n in (samples, samples * horizon))
        return cls(replace(problem, windows=short), replace(problem, windows=long))

    @property
    def samples(self) -> int:
        """Samples of a long rollout."""
        return self.rollouts.windows.samples

    @property
    def seconds(self) -> float:
        """Duration of a long rollout."""
        time = self.rollouts.windows.time
        return float(np.median(time[:, -1] - time[:, 0]))

    def as_long(self, fit: Fit) -> Problem:
        """The recordings that a fit was trained on, in windows as long as the long rollouts."""
        windows = fit.problem.windows
        samples = min(self.samples, *(len(np.asarray(r.t_state)) for r in windows.recordings))
        return replace(self.rollouts, windows=windows.recut(samples=samples))

    def short(self, fit: Fit) -> Fit:
        """A fit on windows, nuisances and parameters free as far as the other recordings leave them; once."""
        return _once(self._predicted, fit, lambda: predict(self.windows, fit))

    def continued(self, fit: Fit) -> Fit:
        """A fit on long rollouts, nuisances and parameters free as far as the other recordings leave them."""
        return freed(self.long(fit), fit)

    def long(self, fit: Fit) -> Fit:
        """A fit on long rollouts, with the pulses of the windows: their times are found best there; once."""

        def rolled() -> Fit:
            pulses = replay(self.windows, fit).point.variant.pulses if fit.point.variant.pulses else ()
            return replay(self.rollouts, fit, 12, pulses)

        return _once(self._rolled, fit, rolled)


def _once(known: list[tuple[Fit, Fit]], fit: Fit, test: Callable[[], Fit]) -> Fit:
    """What a test of a fit gave, or gives now."""
    for asked, tested in known:
        if asked is fit:
            return tested
    known.append((fit, test()))
    return known[-1][1]
