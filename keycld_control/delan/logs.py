"""Robots of other people whose torques were logged, and which of their recordings models learn from.

Files, columns and units are those of the gates (`keycld_control.benchmarks.real`), and so is the division: every third
recording is held out, from the second on.
"""

from dataclasses import dataclass
from pathlib import Path

from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.owners.all_rigs import owners_rigs, parted
from keycld_control.benchmarks.real.rigs import named_rig
from keycld_control.delan import kuka
from keycld_model.delan import Motions, motions_of

OWNERS = ("double pendulum A.0", "double pendulum C.0", "double pendulum C.1", "simple pendulum")
"""Rigs that the gates compare with their owners' models, too."""
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
    """

    training: tuple[RecordingFile, ...]
    held_out: tuple[RecordingFile, ...]

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
    parts = {name: (owners[name].training, owners[name].held_out) for name in OWNERS}
    parts |= {name: parted(named_rig("double_pendulum_C1").some(files, name)) for name, files in CONTROLLED.items()}
    parts["KUKA"] = [kuka.run("A")], [kuka.run("B")]
    return {name: Logs(tuple(training), tuple(held_out)) for name, (training, held_out) in parts.items()}
