"""Everything that is fitted."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.diagnosis.simulation.variant import Pulse, Variant, recording_spreads, rotors, window_spreads

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """A variant of the simulator, and the initial states of W windows.

    Attributes:
        variant: nuisances, effects and pulses.
        q: `[W, nv]` initial positions.
        v: `[W, nv]` initial velocities.
    """

    variant: Variant
    q: Array
    v: Array

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Of the variant."""
        return self.variant.effects

    @property
    def offsets(self) -> Array:
        """Offsets of rotors at the starts of windows, `[W, J]`; J is zero where they follow from the recording."""
        offsets = self.variant.window_offsets
        return np.zeros((len(self.q), 0)) if offsets is None else offsets

    @property
    def offset_spreads(self) -> Array:
        """Standard deviations expected of these offsets, `[J]`."""
        return np.zeros(0) if self.variant.window_offsets is None else window_spreads(self.effects)

    @property
    def fitted_recording_spreads(self) -> Array:
        """Standard deviations of what is fitted of the starts of recordings, `[M]`; nothing where windows have it."""
        return np.zeros(0) if self.variant.window_offsets is not None else recording_spreads(self.effects)

    def take(self, index: NDArray[np.int64]) -> "Point":
        """Some of the windows."""
        offsets = self.variant.window_offsets
        return replace(self, q=self.q[index], v=self.v[index]).with_offsets(None if offsets is None else offsets[index])

    def moved(self, step: Array) -> "Point":
        """After a step of initial positions, velocities and offsets, `[W, 2 nv + J]`."""
        nv = self.q.shape[1]
        offsets = self.variant.window_offsets
        out = replace(self, q=self.q + step[:, :nv], v=self.v + step[:, nv : 2 * nv])
        return out.with_offsets(None if offsets is None else offsets + step[:, 2 * nv :])

    def with_offsets(self, offsets: Array | None) -> "Point":
        """With these offsets of rotors at the starts of windows, `[W, J]`."""
        return replace(self, variant=replace(self.variant, window_offsets=offsets))

    def with_free_rotors(self) -> "Point":
        """With rotors, if there are any, that may be anywhere at the starts of windows."""
        number = len(window_spreads(self.effects))
        if self.variant.window_offsets is not None or not number:
            return self
        return self.with_offsets(np.zeros((len(self.q), number)))

    def with_effects(self, *effects: Effect) -> "Point":
        """With these effects instead."""
        return replace(self, variant=self.variant.with_effects(*effects))

    def with_pulses(self, *pulses: Pulse) -> "Point":
        """With these pulses instead."""
        return replace(self, variant=replace(self.variant, pulses=pulses))

    def recording_offsets(self, recordings: int) -> Array:
        """Hidden states of effects at the start of each recording, `[R, M]`, a copy."""
        offsets = self.variant.recording_offsets
        return np.zeros((recordings, len(recording_spreads(self.effects)))) if offsets is None else offsets.copy()

    def offset_costs(self) -> Array:
        """Nats that each window's offsets cost, `[W]`."""
        return 0.5 * np.sum((self.offsets / self.offset_spreads) ** 2, axis=1)

    def elsewhere_in_play(self) -> list["Point"]:
        """With each rotor elsewhere in its play."""
        out, at = [], 0
        for effect in rotors(self.effects) if self.variant.window_offsets is not None else ():
            for halves in (-2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0):
                if effect.play > 0:
                    offsets = self.offsets.copy()
                    offsets[:, at] += halves * effect.play
                    out.append(self.with_offsets(offsets))
            at += effect.memory
        return out


def mixed(first: NDArray[np.bool_], one: Point, other: Point) -> Point:
    """States of windows from one point where `first`, `[W, 1]`, and from another elsewhere, whose variant it has."""
    a, b = one.variant.window_offsets, other.variant.window_offsets
    offsets = None if a is None or b is None else np.where(first, a, b)
    return replace(other, q=np.where(first, one.q, other.q), v=np.where(first, one.v, other.v)).with_offsets(offsets)
