"""Any data set of episodes that can be imported, by what its folder holds."""

from pathlib import Path

from keycld_envs.errors import InputError
from keycld_envs.recordings.importers.lerobot import INFO, LeRobotFolder
from keycld_envs.recordings.importers.minari import METADATA, MinariFolder


def open_data_set(folder: Path, camera: str | None = None) -> LeRobotFolder | MinariFolder:
    """Open a data set of LeRobot or Minari, whose episodes can be iterated over.

    Args:
        folder: where it lies.
        camera: name of the frames to read, "none" for none; by default the first.

    Raises:
        InputError: if the folder is neither, damaged, or the package for it is missing.
    """
    if (folder / INFO).is_file():
        return LeRobotFolder(folder, camera)
    if (folder / METADATA).is_file():
        return MinariFolder(folder, camera)
    raise InputError(f"{folder} holds neither {INFO} of LeRobot nor {METADATA} of Minari; name a data set or a file.")
