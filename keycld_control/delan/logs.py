"""Robots of other people whose torques were logged, and which of their recordings models learn from.

Files, columns and units are those of the gates (`keycld_control.benchmarks.real`), and so is the division: every third
recording is held out, from the second on.
"""

from dataclasses import dataclass
from pathlib import Path

import mujoco

from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.owners.all_rigs import owners_rigs, parted
from keycld_control.benchmarks.real.rigs import named_rig
from keycld_control.delan import kuka
from keycld_model.delan import Motions, motions_of

OWNERS = {
    "double pendulum A.0": "double_pendulum_A0",
    "double pendulum C.0": "double_pendulum_C0",
    "double pendulum C.1": "double_pendulum_C1",
    "simple pendulum": "simple_pendulum",
}
"""Rigs that the gates compare with their owners' models, too, and their names among those of the gates."""
CONTROLLED = {
    "pendubot": ("pendubot_ilqr", "pendubot_mcpilco", "pendubot_sac"),
    "acrobot": ("acrobot_ilqr", "acrobot_mcpilco"),
}
"""Controllers that swing design C.1 up with one motor; the other one compensates for its friction."""


@dataclass(frozen=True)
class Logs:
    """Recordings of one robot.

    Attributes:
        training: to learn from.
        held_out: whole recordings that no model has seen.
        rig: that has a simulator of it; None if there is none.
    """

    training: tuple[RecordingFile, ...]
    held_out: tuple[RecordingFile, ...]
    rig: str | None = None

    def simulator(self, folder: Path) -> mujoco.MjModel | None:
        """With masses as the owners identified them, and without friction.

        Raises:
            InputError: if a file is missing or damaged.
        """
        return None if self.rig is None else named_rig(self.rig).simulator(folder)

    def motions(self, folder: Path, band: float) -> tuple[Motions, Motions]:
        """To learn from, and held out, low-passed at `band`, Hz.

        Raises:
            InputError: if a file is missing or damaged.
        """
        training, held_out = ([file.recording(folder) for file in files] for files in (self.training, self.held_out))
        return motions_of(str(folder), training, band), motions_of(str(folder), held_out, band)


def all_logs() -> dict[str, Logs]:
    """By the name of the robot."""
    owners = owners_rigs()
    out = {name: Logs(tuple(owners[name].training), tuple(owners[name].held_out), rig) for name, rig in OWNERS.items()}
    for name, files in CONTROLLED.items():
        training, held_out = parted(named_rig("double_pendulum_C1").some(files, name))
        out[name] = Logs(tuple(training), tuple(held_out), "double_pendulum_C1")
    return out | {"KUKA": Logs((kuka.run("A"),), (kuka.run("B"),))}
