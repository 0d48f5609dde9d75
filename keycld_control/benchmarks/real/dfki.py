"""The double pendulum of the DFKI Underactuated Lab: its files, and its simulator."""

from collections.abc import Callable, Mapping
from pathlib import Path

import mujoco

from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.owners.files import numbers_of
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
    path = f"dfki_double_pendulum/leaderboard/{run}/trajectory.csv"
    return _recording_file(path, id, torque, run.split("/")[-1])


def _recording_file(path: str, id: str, torque: str, what: str) -> RecordingFile:
    columns = Columns(
        "time",
        {joint: f"pos_meas{j}" for j, joint in enumerate(JOINTS, 1)},
        {joint: f"vel_meas{j}" for j, joint in enumerate(JOINTS, 1)},
        {joint: f"{torque}{j}" for j, joint in enumerate(JOINTS, 1)},
        units={f"pos_meas{j}": "rad" for j, _ in enumerate(JOINTS, 1)},
    )
    return RecordingFile(path, columns, id, "BSD-3-Clause", f"dfki-ric-underactuated-lab/double_pendulum: {what}")


RUNS = {
    "A.0": [f"design_A.0/20220815/sys_id/trajectory_{i:02d}.csv" for i in range(6)],
    "C.0": [f"design_C.0/20220914/sys_id/trajectory_{i:02d}.csv" for i in range(7)],
    "C.1": [
        f"design_C.1/sys_id/20230629/20230629-{i}/trajectory.csv"
        for i in ("143339", "143524", "143601", "143704", "154220")
    ],
}
"""Files of the runs with which designs were identified, in which both joints move."""


def identified(design: str, model: str) -> Callable[[Path], mujoco.MjModel]:
    """A simulator with the parameters that the owners identified, without their friction; made of the data's folder."""

    def made(folder: Path) -> mujoco.MjModel:
        known = parameters(folder, design, model)
        return double_pendulum(*_links(known), known["l1"])

    return made


def _links(known: Mapping[str, float]) -> tuple[RigidLink, RigidLink]:
    """Both links.

    Where the second has less inertia than its mass at a point, mass at the elbow goes from the first to the second:
    both move in the same way with it.
    """
    m1, m2, l1, rotor = known["m1"], known["m2"], known["l1"], known["gr"] ** 2 * known["Ir"]
    lever = m2 * known["r2"]
    more = max(0.0, 1.01 * lever**2 / known["I2"] - m2)
    upper = RigidLink(m1, known["r1"] - more * l1 / m1, known["I1"] - more * l1**2, rotor)
    return upper, RigidLink(m2 + more, lever / (m2 + more), known["I2"], rotor)


def parameters(folder: Path, design: str, model: str) -> dict[str, float]:
    """What the owners identified.

    Raises:
        InputError: if the file is missing or damaged.
    """
    path = (
        "dfki_double_pendulum/data/system_identification/identified_parameters/"
        f"design_{design}/model_{model}/model_parameters.yml"
    )
    needed = ("m1", "m2", "r1", "r2", "I1", "I2", "l1", "Ir", "gr", "b1", "b2", "cf1", "cf2")
    return numbers_of(folder / path, needed)


def leaderboard_runs(plant: str, controller: str, number: int) -> list[RecordingFile]:
    """Undisturbed runs of a controller, with the torque that was commanded."""
    return [
        run_file(f"{plant}/real_hardware_v2/src_data/{controller}/experiment{i:02d}", f"{plant}-{i}", "tau_con")
        for i in range(1, number + 1)
    ]


def system_identification_runs(design: str) -> list[RecordingFile]:
    """Runs in which both joints are driven to be identified, with the torque that was commanded."""
    return [
        _recording_file(f"dfki_double_pendulum/data/experiment_records/{path}", f"{design} {i}", "tau_con", "sys_id")
        for i, path in enumerate(RUNS[design])
    ]
