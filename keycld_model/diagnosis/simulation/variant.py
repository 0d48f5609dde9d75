"""A simulator with other parameters and other physics."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_envs.effects.transmission import TransmissionEffect

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pulse:
    """A push from outside, a rectangle or half a sine in time.

    Attributes:
        recording: index of the recording.
        dof: index of the joint among the velocities.
        start: s, on the recording's clock.
        duration: s.
        force: greatest force, N m or N.
        rounded: it is half a sine, not a rectangle.
    """

    recording: int
    dof: int
    start: float
    duration: float
    force: float
    rounded: bool = False

    def impulse(self, t: Array) -> Array:
        """Impulse from its start to times, N m s or N s."""
        since = np.clip(t - self.start, 0.0, self.duration)
        if not self.rounded:
            return self.force * since
        return self.force * self.duration / np.pi * (1 - np.cos(np.pi * since / self.duration))


@dataclass(frozen=True)
class Variant:
    """A simulator with other numbers and other physics.

    Attributes:
        values: of the nuisances, the simulator's before the sensor's.
        effects: physics that is added.
        pulses: pushes from outside, in the recordings that are simulated.
        recording_offsets: `[R, M]` hidden states of effects at the start of each recording, beyond where effects begin.
        window_offsets: `[W, J]` hidden states of rotors at the start of each window that is simulated, beyond what
            the recording before it says.
    """

    values: Array
    effects: tuple[Effect, ...] = ()
    pulses: tuple[Pulse, ...] = ()
    recording_offsets: Array | None = None
    window_offsets: Array | None = None

    def for_other_recordings(self) -> "Variant":
        """Without what belongs to the recordings at hand."""
        return replace(self, pulses=(), recording_offsets=None, window_offsets=None)

    def with_effects(self, *effects: Effect) -> "Variant":
        """With these effects instead; rotors that stay are where they were."""
        offsets = self.window_offsets
        if offsets is not None:
            here = {effect.key: self.window_offsets_of(effect, len(offsets)) for effect in rotors(self.effects)}
            kept = [here.get(e.key, np.zeros((len(offsets), e.memory))) for e in rotors(effects)]
            offsets = np.concatenate(kept, axis=1) if kept else None
        return replace(self, effects=effects, recording_offsets=None, window_offsets=offsets)

    def window_offsets_of(self, effect: Effect, windows: int) -> Array:
        """Offsets of one effect at the starts of windows, `[W, memory]`."""
        if self.window_offsets is None or not isinstance(effect, TransmissionEffect):
            return np.zeros((windows, effect.memory))
        first = sum(e.memory for e in itertools.takewhile(lambda e: e is not effect, rotors(self.effects)))
        return self.window_offsets[:, first : first + effect.memory]

    def recording_offsets_of(self, effect: Effect, recordings: int) -> Array:
        """Offsets of one effect at the starts of recordings, `[R, memory]`."""
        if self.recording_offsets is None:
            return np.zeros((recordings, effect.memory))
        before = itertools.takewhile(lambda e: e is not effect, self.effects)
        first = sum(len(e.memory_spread) for e in before)
        return self.recording_offsets[:, first : first + effect.memory]


def recording_spreads(effects: Sequence[Effect]) -> Array:
    """Standard deviations expected of hidden states at the start of a recording, `[M]`."""
    return np.array([spread for effect in effects for spread in effect.memory_spread])


def rotors(effects: Sequence[Effect]) -> list[TransmissionEffect]:
    """Effects with a rotor: it swings fast, and where it is follows only roughly from how the joint moved."""
    return [effect for effect in effects if isinstance(effect, TransmissionEffect)]


def window_spreads(effects: Sequence[Effect]) -> Array:
    """Standard deviations expected of offsets of rotors at the starts of windows, `[J]`."""
    return np.array([spread for effect in rotors(effects) for spread in effect.memory_spread])
