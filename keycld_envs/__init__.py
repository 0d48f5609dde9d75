"""Environments, systems and recordings of KeyCLD. NumPy and MuJoCo only; opens no OpenGL until a frame is rendered."""

from importlib.metadata import version

from keycld_envs.opengl import import_mujoco

import_mujoco()

from keycld_envs.env import KeyCLDEnv  # noqa: E402
from keycld_envs.errors import InputError  # noqa: E402
from keycld_envs.mechanism import Mechanism, Rod, Slider  # noqa: E402
from keycld_envs.registration import make, register, register_all, resolve_env_id, system_of  # noqa: E402
from keycld_envs.systems import (  # noqa: E402
    REFERENCE_SYSTEMS,
    SYSTEMS,
    Joint,
    Landmark,
    System,
    Tolerance,
    get_system,
)

register_all()

__version__ = version("keycld")

__all__ = [
    "REFERENCE_SYSTEMS",
    "SYSTEMS",
    "InputError",
    "Joint",
    "KeyCLDEnv",
    "Landmark",
    "Mechanism",
    "Rod",
    "Slider",
    "System",
    "Tolerance",
    "get_system",
    "make",
    "register",
    "resolve_env_id",
    "system_of",
]
