"""Steps per second of the diagnosis' compiled rollouts beside MuJoCo's batched ones, on this machine, in one run.

Usage: python examples/rollout_speed.py
"""

import time

import mujoco
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from keycld_envs.systems import REFERENCE_SYSTEMS, get_system
from keycld_model.rigid_body.compiled import CompiledEngine
from keycld_model.rigid_body.effects import AppliedEffects
from keycld_model.rigid_body.engine import Copies, Engine, MujocoEngine

ROLLOUTS, STEPS = 1024, 40


def seconds(by: Engine, model: mujoco.MjModel, state: np.ndarray, control: np.ndarray, repeats: int) -> list[float]:
    """Of rollouts of all states, after one that does not count."""
    one = np.zeros(len(state), int)
    batch = by.batch(Copies([model], [AppliedEffects()], one, one))
    whole = np.zeros((len(state), by.size))
    whole[:, by.motion] = state
    out = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        by.run(batch, whole, control, np.zeros(len(state)))
        out.append(time.perf_counter() - start)
    return out[1:]


def main(repeats: int = 7, seed: int = 0) -> None:
    """Print a table of microseconds per Runge-Kutta step, and their ratio.

    Args:
        repeats: Runs of each, in turns; medians count.
        seed: Of states and commands.
    """
    rng = np.random.default_rng(seed)
    table = Table("system", "MuJoCo, 1 thread, us", "MuJoCo, 2 threads, us", "compiled, us", "ratio to 2 threads")
    for name in REFERENCE_SYSTEMS:
        model = get_system(name).compile()
        model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 0.01
        mechanism = CompiledEngine.of(model)
        assert mechanism is not None
        state = rng.normal(0, 0.5, (ROLLOUTS, 2 * model.nv))
        control = rng.normal(0, 1, (ROLLOUTS, STEPS, model.nu + model.nv))
        engines: list[Engine] = [MujocoEngine(model, 1), MujocoEngine(model, 2), mechanism]
        micro = [1e6 * np.median(seconds(e, model, state, control, repeats)) / ROLLOUTS / STEPS for e in engines]
        table.add_row(name, *(f"{m:.2f}" for m in micro), f"{micro[1] / micro[2]:.1f}")
    Console().print(table)


if __name__ == "__main__":
    tyro.cli(main)
