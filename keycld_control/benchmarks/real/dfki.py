"""The double pendulum of the DFKI Underactuated Lab: its recordings, and its simulator."""

from pathlib import Path

import mujoco
import numpy as np

from keycld_control.benchmarks.real.gate import Array, locate
from keycld_control.benchmarks.real.rigs import Link, double_pendulum
from keycld_envs.recordings import Recording
from keycld_envs.recordings.importers import Columns, Table, assemble, read_csv

FOLDER = "dfki_double_pendulum/leaderboard"
JOINTS = ("shoulder", "elbow")


def simulator() -> mujoco.MjModel:
    """Design C.1, model 1.0 (design_C.1/model_1.0/model_parameters.yml) without its friction.

    The rotor's inertia of 6.287e-5 kg m² behind a gear of 6 is an armature; what the second rotor adds to the coupling
    of both joints (0.4 % of the inertia) is left out.
    """
    rotor = 6**2 * 6.287203962819607e-05
    upper = Link(0.5234602302310271, 0.2, 0.031887199591513114, rotor)
    lower = Link(0.6255677234174437, 0.25569305436052964, 0.05086984812807257, rotor)
    return double_pendulum(upper, lower, 0.2)


def table(folder: Path, run: str) -> Table:
    """Everything that was logged in a run."""
    return read_csv(locate(folder, f"{FOLDER}/{run}/trajectory.csv"))


def recording(logged: Table, id: str, torque: str) -> Recording:
    """Measured positions and velocities.

    Args:
        logged: see `table`.
        id: name.
        torque: "tau_con" for what was commanded, "tau_meas" for what the motors report.
    """
    columns = Columns(
        "time",
        {joint: f"pos_meas{j}" for j, joint in enumerate(JOINTS, 1)},
        {joint: f"vel_meas{j}" for j, joint in enumerate(JOINTS, 1)},
        {joint: f"{torque}{j}" for j, joint in enumerate(JOINTS, 1)},
    )
    origin = f"dfki-ric-underactuated-lab/double_pendulum: {logged.path.parent.name}"
    return assemble(logged, columns, id, licence="BSD-3-Clause", origin=origin)


def pushes(logged: Table) -> Array:
    """The torques added as a disturbance, `[N, 2]`, N m; zero in undisturbed runs."""
    if "tau_pert1" not in logged.columns:
        return np.zeros((len(logged.column("time")), 2))
    return np.stack([logged.column("tau_pert1"), logged.column("tau_pert2")], axis=1)
