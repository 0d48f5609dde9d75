"""Who steps: MuJoCo itself, or a compiled `Mechanism` where a model is simple enough for that."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from keycld_model.rigid_body.effects import Pushing

Array = NDArray[np.float64]
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
_CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_QFRC_APPLIED.value


@dataclass(frozen=True)
class Copies:
    """N copies of some variants of a mechanism.

    Attributes:
        models: of the variants.
        pushing: effects of each variant.
        of: `[N]` variant of each copy.
        window: `[N]` window of each copy.
    """

    models: Sequence[mujoco.MjModel]
    pushing: Sequence[Pushing]
    of: NDArray[np.int64]
    window: NDArray[np.int64]


class Rollouts(Protocol):
    """Steps many copies of a mechanism."""

    @property
    def size(self) -> int:
        """Numbers of a state."""
        ...

    @property
    def motion(self) -> slice:
        """Where positions and velocities are in it."""
        ...

    def batch(self, copies: Copies) -> Any:
        """Ready to be run."""
        ...

    def run(self, batch: Any, state: Array, control: Array, time: Array) -> Array:
        """States after every step, `[N, S, size]`; not finite where a rollout diverges.

        Args:
            batch: the copies.
            state: `[N, size]` at first.
            control: `[N, S, nu + nv]` commands and forces from outside, held over each step.
            time: `[N]` s, at first, for effects.
        """
        ...


class MujocoRollouts:
    """By MuJoCo, which can step anything but effects that push; see `Rollouts`."""

    def __init__(self, model: mujoco.MjModel, threads: int) -> None:
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads)
        self._size, self._motion = mujoco.mj_stateSize(model, _STATE), slice(1, 1 + 2 * model.nv)

    @property
    def size(self) -> int:
        """See `Rollouts`."""
        return self._size

    @property
    def motion(self) -> slice:
        """See `Rollouts`."""
        return self._motion

    def batch(self, copies: Copies) -> Any:
        """See `Rollouts`; without effects."""
        if any(some.effects for some in copies.pushing):
            raise ValueError("MuJoCo's rollouts know no effects; their forces must be set step by step.")
        return [copies.models[i] for i in copies.of]

    def run(self, batch: Any, state: Array, control: Array, time: Array) -> Array:
        """See `Rollouts`."""
        out = np.empty((*control.shape[:2], self.size))
        self._pool.rollout(batch, self._data, state, np.ascontiguousarray(control), control_spec=_CONTROL, state=out)
        return out
