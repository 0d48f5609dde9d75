"""`keycld delan` with recipes of a few steps, saved after each: python small_delan.py WORDS.

`small_delan.py data FOLDER` writes what its commands read: letters.npz, and logs of a simple pendulum.
"""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from keycld_control.cli import console
from keycld_control.delan.logs import all_logs
from keycld_model.delan import presets, training


def write_data(folder: Path) -> None:
    """Twenty letters, drawn by two joints that know nothing of each other, and a pendulum's logs at 500 Hz."""
    names = "abcdefghijklmnopqrtv"
    q, v, a = _waves(0.04 * np.arange(24 * len(names)), 2)
    truth = {"m": np.array([0.5, 0.3]) * a, "c": 0 * v, "g": np.array([2.0, 1.0]) * np.sin(q)}
    parts = {"labels": np.array(list(names)), "lengths": np.full(len(names), 24)}
    clock = np.tile(0.04 * np.arange(24), len(names))
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "letters.npz", t=clock, qp=q, qv=v, qa=a, tau=truth["m"] + truth["g"], **truth, **parts)
    logs = all_logs()["simple pendulum"]
    for i, file in enumerate((*logs.training, *logs.held_out)):
        t = 0.002 * np.arange(2000) + 10 * i
        q, v, a = _waves(t, 1)
        table = np.column_stack([t - t[0], q, v, 0.5 * a + 2 * np.sin(q) + 0.3 * v])
        path = folder / "logs" / file.path
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, table, delimiter=",", header="time,position,velocity,torque", comments="")


def _waves(t: np.ndarray, joints: int) -> tuple[np.ndarray, ...]:
    """Positions, velocities and accelerations `[T, joints]`."""
    height, rate = np.array([0.9, 0.5, 0.3])[:, None, None], np.array([1.1, 2.3, 3.7])[:, None, None]
    phase = rate * t[:, None] + np.arange(joints)
    return tuple((height * x).sum(0) for x in (np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)))


if __name__ == "__main__":
    if sys.argv[1] == "data":
        write_data(Path(sys.argv[2]))
        sys.exit()
    jax.config.update("jax_disable_most_optimizations", True)
    for name, recipe in presets.PRESETS.items():
        presets.PRESETS[name] = replace(recipe, width=4, iterations=6)
    training.SAVE_EVERY = 0.0
    sys.argv.insert(1, "delan")
    console()
