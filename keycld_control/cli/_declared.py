"""What a word on the command line declares: an environment with a mechanism, or a mechanism alone."""

from keycld_envs import Mechanism, System, resolve_env_id, system_of
from keycld_envs.errors import InputError
from keycld_envs.mechanism_file import is_mechanism_file, read_mechanism_file
from keycld_envs.reading import read_json


def declared(system: str) -> tuple[str | None, Mechanism]:
    """Environment, if there is one, and mechanism.

    Args:
        system: short name, environment id, module:id, Python file, or JSON file with a mechanism's declaration.

    Raises:
        InputError: if it means nothing, or cannot be read.
    """
    if system.endswith(".json"):
        try:
            return None, Mechanism.from_dict(read_json(system))
        except (OSError, ValueError) as error:
            raise InputError(f"{system} is no readable mechanism declaration: {error}") from error
    if is_mechanism_file(system) and not isinstance(found := read_mechanism_file(system), System):
        return None, found
    name = resolve_env_id(system)
    return name, system_of(name).mechanism
