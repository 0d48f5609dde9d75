"""The simulator of a folder of recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from keycld_envs.recordings import Recording
    from keycld_model.diagnosis import Source


def simulator_of(
    folder: Path, recordings: "Sequence[Recording]", mjcf: Path | None, environment: str | None
) -> "Source":
    """The one that is named, or that of the recordings, an environment with the range that motors were recorded with.

    Raises:
        InputError: if recordings name several and none is given, or it cannot be used.
    """
    from keycld_envs.collect import action_range_of
    from keycld_envs.errors import InputError
    from keycld_model.diagnosis import Source

    systems = {recording.system for recording in recordings}
    if mjcf is None and environment is None and len(systems) > 1:
        raise InputError(
            f"{folder}, field system: the recordings name {len(systems)} simulators, "
            f"{', '.join(sorted(map(str, systems)))}; say which to take, by --env or --mjcf."
        )
    return Source.of(mjcf, environment or recordings[0].system, action_range_of(folder))
