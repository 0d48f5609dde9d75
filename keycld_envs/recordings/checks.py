"""Whether joint positions of a recording are in units that simulators have."""

from keycld_envs.errors import InputError
from keycld_envs.recordings.recording import Recording

POSITIONS = ("rad", "m", "1", "")
"""Units of positions; one that nobody has written is believed to be the simulator's."""


def check_units(recording: Recording) -> None:
    """Raise InputError if a recording says that its joint positions are in other units than rad and m."""
    units = recording.units.get("qpos", "")
    for j, name in enumerate(recording.joint_names):
        unit = units if isinstance(units, str) else units[j]
        if unit not in POSITIONS:
            raise InputError(
                f"Recording {recording.id!r} has positions of {name!r} in {unit!r}; convert qpos to rad or m."
            )
