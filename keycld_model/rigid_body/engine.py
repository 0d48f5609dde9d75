"""Who steps: MuJoCo itself, or compiled steps where a model is simple enough for these."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from keycld_model.rigid_body.effects import AppliedEffects

Array = NDArray[np.float64]
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
_CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_QFRC_APPLIED.value


Batch = TypeVar("Batch")
"""What an engine makes of copies, and runs."""


@dataclass(frozen=True)
class Copies:
    """N copies of some variants of a mechanism.

    Attributes:
        models: of the variants.
        applied: effects of each variant, with what they remember.
        of: `[N]` variant of each copy.
        window: `[N]` window of each copy.
    """

    models: Sequence[mujoco.MjModel]
    applied: Sequence[AppliedEffects]
    of: NDArray[np.int64]
    window: NDArray[np.int64]


class Engine(Protocol[Batch]):
    """Steps many copies of a mechanism."""

    @property
    def size(self) -> int:
        """Numbers of a state."""
        ...

    @property
    def motion(self) -> slice:
        """Where positions and velocities are in it."""
        ...

    def batch(self, copies: Copies) -> Batch:
        """Rollouts that are ready to be run."""
        ...

    def run(self, batch: Batch, state: Array, control: Array, time: Array) -> Array:
        """States after every step, `[N, S, size]`; not finite where a rollout diverges.

        Args:
            batch: the copies.
            state: `[N, size]` at first.
            control: `[N, S, nu + nv]` commands and forces from outside, held over each step.
            time: `[N]` s, at first, for effects.
        """
        ...


class MujocoEngine:
    """MuJoCo's own steps, of any model, without effects that push; see `Engine`."""

    def __init__(self, model: mujoco.MjModel, threads: int) -> None:
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads)
        self._size, self._motion = mujoco.mj_stateSize(model, _STATE), slice(1, 1 + 2 * model.nv)

    @property
    def size(self) -> int:
        """Numbers of a state."""
        return self._size

    @property
    def motion(self) -> slice:
        """Where positions and velocities are in it."""
        return self._motion

    def batch(self, copies: Copies) -> list[mujoco.MjModel]:
        """The model of every copy."""
        if any(some.effects for some in copies.applied):
            raise ValueError("MuJoCo's steps know no effects; their forces must be set step by step.")
        return [copies.models[i] for i in copies.of]

    def run(self, batch: list[mujoco.MjModel], state: Array, control: Array, time: Array) -> Array:
        """States after every step, `[N, S, size]`; see `Engine`."""
        out = np.empty((*control.shape[:2], self.size))
        self._pool.rollout(batch, self._data, state, np.ascontiguousarray(control), control_spec=_CONTROL, state=out)
        return out
