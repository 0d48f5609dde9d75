"""Choice of the OpenGL backend, before `mujoco` reads it from the environment. Opens nothing."""

import ctypes
import ctypes.util
import os
import platform
from typing import Any

from keycld_envs.errors import InputError

_LIBRARIES = {"egl": ("EGL", "libEGL.so.1"), "osmesa": ("OSMesa", "libOSMesa.so.8")}
_PACKAGES = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
_HEADLESS = tuple(_LIBRARIES)
_OFF = ("disable", "disabled", "off", "false", "0")


def library_loads(backend: str) -> bool:
    """Whether the shared library of `backend` ("egl" or "osmesa") can be loaded on this machine."""
    stem, soname = _LIBRARIES[backend]
    try:
        ctypes.CDLL(ctypes.util.find_library(stem) or soname)
    except OSError:
        return False
    return True


def import_mujoco() -> None:
    """Import `mujoco` with an OpenGL backend that can work on this machine.

    On Linux with neither MUJOCO_GL nor DISPLAY set, MUJOCO_GL becomes "egl", or else "osmesa", whichever
    library loads first. `mujoco` itself cannot be imported when MUJOCO_GL names a library that is missing: it is
    then imported without rendering, so that state observations still work and `create_context` can say why
    pixels do not.
    """
    if platform.system() == "Linux" and not os.environ.get("MUJOCO_GL") and not os.environ.get("DISPLAY"):
        usable = next((name for name in _HEADLESS if library_loads(name)), None)
        if usable:
            os.environ["MUJOCO_GL"] = usable
    requested = os.environ.get("MUJOCO_GL", "").strip().lower()
    if requested in _LIBRARIES and not library_loads(requested):
        os.environ["MUJOCO_GL"] = "disabled"
        try:
            import mujoco  # noqa: F401
        finally:
            os.environ["MUJOCO_GL"] = requested
    else:
        import mujoco  # noqa: F401


def create_context(width: int, height: int) -> Any:
    """Open an OpenGL context of the backend that MUJOCO_GL names, large enough for `width` x `height` pixels.

    Raises:
        InputError: if no context can be opened; the message names the Debian packages to install.
    """
    backend = os.environ.get("MUJOCO_GL", "").strip().lower()
    if backend in _OFF:
        raise InputError(
            f"Rendering is switched off by MUJOCO_GL={backend}; unset it, or use obs_type='state' without render()."
        )
    if backend in _LIBRARIES and not library_loads(backend):
        raise InputError(
            f"The OpenGL library of MUJOCO_GL={backend} cannot be loaded; install it (Debian, Ubuntu: "
            f"apt-get install {_PACKAGES[backend]}), or use obs_type='state' without render()."
        )
    try:
        if backend == "egl":
            from mujoco.egl import GLContext  # pyright: ignore[reportMissingImports]
        elif backend == "osmesa":
            from mujoco.osmesa import GLContext  # pyright: ignore[reportMissingImports]
        else:
            from mujoco.gl_context import GLContext  # pyright: ignore[reportAttributeAccessIssue]
        context = GLContext(width, height)
        context.make_current()
    except Exception as error:  # PyOpenGL raises AttributeError, TypeError and its own types for a missing driver
        packages = " or ".join(_PACKAGES.values())
        raise InputError(
            f"No OpenGL context could be opened ({backend or 'default backend'}: {error}); install a software "
            f"renderer (Debian, Ubuntu: apt-get install {packages}) and set MUJOCO_GL to egl or osmesa."
        ) from error
    return context
