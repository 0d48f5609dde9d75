"""Recordings of mechanisms with known missing physics, injected by code that shares nothing with the effects."""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.windows import Windows, cut
from keycld_model.diagnosis.simulation.simulator import Simulator

STEP, SAMPLE = 0.001, 0.01
NOISE = 1e-3


def recordings(
    system: str,
    seed: int,
    force: Callable[..., np.ndarray] | None = None,
    command: Callable[[np.ndarray], np.ndarray] | None = None,
    errors: float = 0.1,
    number: int = 9,
    seconds: float = 3.0,
) -> list[Recording]:
    """Runs of a system whose masses are off by up to `errors`, and whose encoders are not quite at zero.

    Args:
        system: short name.
        seed: of everything random.
        force: generalised force [nv] that is missing, of time, qpos, qvel, and the command.
        command: what motors make of commands [T, nu].
        errors: relative.
        number: of recordings.
        seconds: of each.
    """
    rng, declared = np.random.default_rng(seed), get_system(system)
    model = declared.compile()
    for body in range(1, model.nbody):
        factor = rng.uniform(1 - errors, 1 + errors)
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    zero, t = rng.normal(0, 0.01, model.nv), np.arange(round(seconds / SAMPLE), dtype=np.float64) * SAMPLE
    out = []
    for run in range(number):
        strength = (0.0, 0.5, 1.0)[run % 3]
        u = np.repeat(rng.uniform(-1, 1, (len(t) // 15 + 1, model.nu)), 15, axis=0)[: len(t)] * strength
        mujoco.mj_resetData(model, data)
        data.qpos[:] = declared.hanging_qpos + rng.uniform(-1, 1, model.nv)
        data.qvel[:] = rng.normal(0, 0.5, model.nv)
        got, q = (u if command is None else command(u)), np.empty((len(t), model.nv))
        for k in range(len(t)):
            q[k] = data.qpos
            for _ in range(round(SAMPLE / STEP)):
                data.ctrl[:] = got[k]
                if force is not None:
                    data.qfrc_applied[:] = force(data.time, data.qpos, data.qvel, got[k])
                mujoco.mj_step(model, data)
        out.append(
            Recording(
                id=f"run-{run}",
                source="simulation",
                joint_names=tuple(joint.name for joint in declared.joints),
                actuator_names=declared.actuators,
                units={"action": "1", "qpos": "rad"},
                t_action=t,
                action=u,
                t_state=t,
                qpos=q + zero + rng.normal(0, NOISE, q.shape),
            )
        )
    return out


def windows_of(
    runs: Sequence[Recording], model: mujoco.MjModel, step: float = 0.01, samples: int = 40, noise: float = NOISE
) -> Windows:
    """Runs in windows, their sensors' noise known."""
    return cut(runs, JointPositions(model, np.full(model.nv, noise)), step, samples)


def problem_of(simulator: Simulator, runs: Sequence[Recording], noise: float = NOISE, samples: int = 40) -> Problem:
    """Runs to be explained by a simulator."""
    return Problem(simulator, windows_of(runs, simulator.model, simulator.step, samples, noise))
