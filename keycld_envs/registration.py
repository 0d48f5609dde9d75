"""Gymnasium ids, and how people shorten them."""

import difflib
import importlib
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

from keycld_envs.checks import short
from keycld_envs.errors import InputError
from keycld_envs.mechanism_file import is_mechanism_file, read_system
from keycld_envs.systems import REFERENCE_SYSTEMS, SYSTEMS, System, get_system

MAX_EPISODE_STEPS = 1000
_ENTRY_POINT = "keycld_envs.env:KeyCLDEnv"
_SHORT_NAMES: dict[str, str] = {}


def register_all() -> None:
    """Register every system: `KeyCLD/Acrobot-v0`, its alias `...FullyActuated-v0`, `KeyCLD/AcrobotStock-v0`."""
    for name, system in SYSTEMS.items():
        fully_actuated = system.mechanism.num_actions == system.mechanism.degrees_of_freedom
        for suffix in ("", "FullyActuated") if name in REFERENCE_SYSTEMS and fully_actuated else ("",):
            env_id = f"KeyCLD/{''.join(map(str.capitalize, name.split('-')))}{suffix}-v0"
            gym.register(env_id, entry_point=_ENTRY_POINT, max_episode_steps=MAX_EPISODE_STEPS, kwargs={"system": name})
            _SHORT_NAMES.setdefault(name, env_id)


def register(system: System, env_id: str, max_episode_steps: int = MAX_EPISODE_STEPS) -> None:
    """Register your own system, so that `gymnasium.make(env_id)` builds it.

    Args:
        system: the declaration; see `keycld_envs.System`.
        env_id: for instance "MyLab/Robot-v0".
        max_episode_steps: steps after which an episode is truncated.
    """
    gym.register(env_id, entry_point=_ENTRY_POINT, max_episode_steps=max_episode_steps, kwargs={"system": system})
    _SHORT_NAMES[system.name] = env_id


def make(name: str, **kwargs: Any) -> gym.Env[Any, Any]:
    """`gymnasium.make` that takes short names and files, "acrobot-stock" or "my_arm.py", and suggests names.

    Args:
        name: an environment id or a short name, see `resolve_env_id`.
        **kwargs: passed on to `gymnasium.make`.

    Raises:
        InputError: if there is no such environment.
    """
    return gym.make(bare_id(resolve_env_id(name)), **kwargs)


def resolve_env_id(name: str) -> str:
    """The environment id that `name` means, for `keycld_envs.make`.

    Args:
        name: an id, or a short name such as "acrobot" or "acrobot-stock". Of environments that a module of yours
            registers, "my_module:MyLab/Slider-v0": the module is imported, and stays part of the result, so that
            other processes import it too. Of a file that declares a `system`, its path, "lab/my_arm.py": the
            environment is registered under the file's name, and the path is the result.

    Raises:
        InputError: if there is none; the message suggests similar names.
    """
    if not isinstance(name, str):
        raise InputError(f"An environment is named by an id, got {short(name)}.")
    if is_mechanism_file(name):
        return _of_file(Path(name))
    module, colon, bare = name.rpartition(":")
    if module == "keycld_envs":
        module, colon = "", ""
    if colon:
        _import(module, name)
    if bare in gym.registry:
        return module + colon + bare
    hyphened = bare.lower().replace("_", "-")
    if hyphened in _SHORT_NAMES:
        return module + colon + _SHORT_NAMES[hyphened]
    known = {key.lower(): key for key in (*_SHORT_NAMES, *_known_ids())}
    similar = [known[key] for key in difflib.get_close_matches(bare.lower(), known, n=3)] or sorted(_SHORT_NAMES)
    similar = [module + colon + each for each in similar]
    if Path(f"{name}.py").is_file():
        similar = [f"{name}.py"]
    if name.lower().endswith(".xml"):
        raise InputError(
            f"{name!r} is no environment; declare one for a MuJoCo XML file, `keycld new my_arm --mjcf {name}`, and "
            "name my_arm.py."
        )
    raise InputError(f"There is no environment {name!r}; did you mean {', '.join(similar)}?")


def bare_id(env_id: str) -> str:
    """The id that Gymnasium knows an environment by, which tells whether two ids mean the same one.

    Args:
        env_id: with or without where it comes from, such as "my_module:MyLab/Slider-v0" or "lab/my_arm.py".

    Returns:
        The id without the module or the folder, such as "MyLab/Slider-v0" or "my_arm.py".
    """
    return Path(env_id).name if is_mechanism_file(env_id) else env_id.rpartition(":")[2]


def same_system(one: str, other: str) -> bool:
    """Whether two environments, by id or short name, are of the same system.

    Of ids that nothing here registers, those are the same that are equal but for the module that registers them.

    Args:
        one: an id, an alias or a short name; with or without a module.
        other: the same.
    """
    if bare_id(one) == bare_id(other):
        return True
    try:
        return system_of(one) == system_of(other)
    except InputError:
        return False


def spec_of(name: str) -> EnvSpec:
    """Gymnasium's specification of an environment, given its id or short name as for `resolve_env_id`.

    `gymnasium.spec` does not take ids that name a module.

    Raises:
        InputError: if there is no such environment.
    """
    return gym.spec(bare_id(resolve_env_id(name)))


def system_of(name: str) -> System:
    """The system of an environment, given its id or short name as for `resolve_env_id`.

    Raises:
        InputError: if there is no such environment, or it is not one of KeyCLD's.
    """
    system = spec_of(name).kwargs.get("system")
    if isinstance(system, str):
        return get_system(system)
    if isinstance(system, System):
        return system
    raise InputError(
        f"{resolve_env_id(name)} is not an environment of a KeyCLD system; register one with keycld_envs.register."
    )


def _of_file(path: Path) -> str:
    """Register what a file declares under the file's name, in place of what may have gone by it."""
    system = read_system(path)
    if re.fullmatch(r"[A-Za-z0-9_.-]+", path.name) is None:
        raise InputError(f"The file name {path.name!r} cannot be an id; use letters, digits, '_', '-' and '.' alone.")
    gym.registry.pop(path.name, None)
    gym.register(path.name, entry_point=_ENTRY_POINT, max_episode_steps=MAX_EPISODE_STEPS, kwargs={"system": system})
    return path.as_posix()


def _import(module: str, name: str) -> None:
    if not all(part.isidentifier() for part in module.split(".")):
        raise InputError(f"{module!r} in {name!r} is no module name; write for instance my_module:MyLab/Slider-v0.")
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise  # the module is there, but not what it imports
        raise InputError(
            f"There is no module {module!r} to import for {name!r}; run in its folder, or install it."
        ) from error


def _known_ids() -> list[str]:
    return [key for key, spec in gym.registry.items() if spec.entry_point == _ENTRY_POINT]
