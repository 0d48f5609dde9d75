"""The double pendulum of the DFKI Underactuated Lab: its files, and its simulator."""

import mujoco

from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.rigs import RigidLink, double_pendulum
from keycld_envs.recordings.importers import Columns

JOINTS = ("shoulder", "elbow")
ILQR_TVLQR_LQR = "acrobot/real_hardware_v2/src_data/ilqr_tvlqr_lqr/experiment01"
"""A run of the acrobot that nobody pushed."""


def simulator() -> mujoco.MjModel:
    """Design C.1, model 1.0 (design_C.1/model_1.0/model_parameters.yml) without its friction.

    The rotor's inertia of 6.287e-5 kg m² behind a gear of 6 is an armature; what the second rotor adds to the coupling
    of both joints (0.4 % of the inertia) is left out.
    """
    rotor = 6**2 * 6.287203962819607e-05
    upper = RigidLink(0.5234602302310271, 0.2, 0.031887199591513114, rotor)
    lower = RigidLink(0.6255677234174437, 0.25569305436052964, 0.05086984812807257, rotor)
    return double_pendulum(upper, lower, 0.2)


def run_file(run: str, id: str, torque: str) -> RecordingFile:
    """Measured positions and velocities of a run.

    Args:
        run: folder of the run.
        id: of the recording.
        torque: "tau_con" for the torque that was commanded, "tau_meas" for what the motors report.
    """
    columns = Columns(
        "time",
        {joint: f"pos_meas{j}" for j, joint in enumerate(JOINTS, 1)},
        {joint: f"vel_meas{j}" for j, joint in enumerate(JOINTS, 1)},
        {joint: f"{torque}{j}" for j, joint in enumerate(JOINTS, 1)},
        units={f"pos_meas{j}": "rad" for j, _ in enumerate(JOINTS, 1)},
    )
    path = f"dfki_double_pendulum/leaderboard/{run}/trajectory.csv"
    origin = f"dfki-ric-underactuated-lab/double_pendulum: {run.split('/')[-1]}"
    return RecordingFile(path, columns, id, "BSD-3-Clause", origin)
