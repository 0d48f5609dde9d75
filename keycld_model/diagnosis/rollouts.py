"""Who steps: MuJoCo itself, or the compiled mechanism where a model is simple enough for that."""

from collections.abc import Sequence
from typing import Any, Protocol

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from keycld_model.diagnosis.mechanism import Mechanism

Array = NDArray[np.float64]
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
_CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_QFRC_APPLIED.value


class Rollouts(Protocol):
    """Steps many copies of a mechanism.

    Attributes:
        size: numbers of a state.
        motion: where positions and velocities are in it.
    """

    size: int
    motion: slice

    def batch(self, models: Sequence[mujoco.MjModel], of: NDArray[np.int64], steps: int) -> Any:
        """N copies, to be run for so many steps at once: which of some variants each has, `[N]`."""
        ...

    def run(self, batch: Any, state: Array, control: Array) -> Array:
        """States after every step, `[N, S, size]`.

        Args:
            batch: the copies.
            state: `[N, size]`.
            control: `[N, S, nu + nv]` commands and forces from outside.
        """
        ...


class MujocoRollouts:
    """By MuJoCo, which can step anything; see `Rollouts`."""

    def __init__(self, model: mujoco.MjModel, threads: int) -> None:
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads)
        self.size = mujoco.mj_stateSize(model, _STATE)
        self.motion = slice(1, 1 + 2 * model.nv)

    def batch(self, models: Sequence[mujoco.MjModel], of: NDArray[np.int64], steps: int) -> Any:
        """See `Rollouts`."""
        return [models[i] for i in of]

    def run(self, batch: Any, state: Array, control: Array) -> Array:
        """See `Rollouts`."""
        out = np.empty((*control.shape[:2], self.size))
        self._pool.rollout(batch, self._data, state, np.ascontiguousarray(control), control_spec=_CONTROL, state=out)
        return out


class CompiledRollouts:
    """By a compiled mechanism; see `Rollouts`."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self.size = 2 * len(mechanism.joints)
        self.motion = slice(0, self.size)

    def batch(self, models: Sequence[mujoco.MjModel], of: NDArray[np.int64], steps: int) -> Any:
        """See `Rollouts`."""
        return self._mechanism.batch(np.stack([self._mechanism.numbers(model) for model in models])[of], steps)

    def run(self, batch: Any, state: Array, control: Array) -> Array:
        """See `Rollouts`."""
        return self._mechanism.run(batch, state, control)
