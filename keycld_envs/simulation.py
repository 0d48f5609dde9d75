"""A mechanism that MuJoCo moves from one control to the next."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from keycld_envs.checks import check_action_limit
from keycld_envs.effects import Effect
from keycld_envs.effects.added_physics import AddedPhysics
from keycld_envs.errors import InputError
from keycld_envs.systems import System

_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


class Simulation:
    """The compiled model of a system with effects, and its state.

    Args:
        system: what is simulated.
        action_limit: symmetric range of every motor; None for the system's.
        effects: physics to add.

    Raises:
        InputError: if the limit or an effect cannot be used.
    """

    def __init__(self, system: System, action_limit: float | None, effects: Sequence[Effect]) -> None:
        self._system = system
        self.model = system.compile()
        self.data = mujoco.MjData(self.model)
        limit = system.action_limit if action_limit is None else check_action_limit(action_limit)
        if limit is not None:
            self.model.actuator_ctrllimited[:] = True
            self.model.actuator_ctrlrange[:] = [-limit, limit]
        self._effects = AddedPhysics(effects, self.model) if effects else None
        self._substeps = round(system.timestep / self.model.opt.timestep)

    def reset(self, qpos: ArrayLike, qvel: ArrayLike) -> None:
        """Start anew from positions [nq] (rad, m) and velocities [nv] (rad/s, m/s)."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        if self._effects:
            self._effects.reset()

    def step(self, control: NDArray[np.float64]) -> None:
        """Hold `control` [m] for one control step.

        Raises:
            InputError: if the simulation diverges.
        """
        self.data.ctrl[:] = control
        before = np.abs(self.data.qvel)
        for _ in self._effects.steps(self.data, self._substeps) if self._effects else range(self._substeps):
            _physics_step(self.model, self.data)
        if any(self.data.warning[kind].number for kind in _DIVERGED):  # MuJoCo has reset the simulation
            joint = f"joint {self._system.joints[before.argmax()].name!r} of " if before.any() else ""
            raise InputError(
                f"The simulation diverged: {joint}system {self._system.name!r} ran away; use smaller actions, "
                "velocities, or time steps."
            )


def _physics_step(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """One time step that ends with up-to-date kinematics and energy, in the same order as dm_control."""
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        mujoco.mj_step(model, data)
    else:
        mujoco.mj_step2(model, data)
    mujoco.mj_step1(model, data)
