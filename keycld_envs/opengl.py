"""Choice of the OpenGL backend, before `mujoco` reads it from the environment. Opens nothing until asked to."""

import ctypes
import ctypes.util
import os
import platform
from typing import Any

from keycld_envs.errors import InputError

_LIBRARIES = {"egl": ("EGL", "libEGL.so.1"), "osmesa": ("OSMesa", "libOSMesa.so.8")}
_PACKAGES = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
_OFF = ("disable", "disabled", "off", "false", "0")
_ON = ("enable", "enabled", "on", "true", "1", "glfw")
_OWN = {"Linux": ("glx", "egl", "osmesa"), "Windows": ("wgl",), "Darwin": ("cgl",)}.get(platform.system(), ())
_KNOWN = (*_OFF, *_ON, *_OWN)

_opened_by: int | None = None  # the process that opened the first context


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
    if not _backend() and _headless():
        usable = next((name for name in _LIBRARIES if library_loads(name)), None)
        if usable:
            os.environ["MUJOCO_GL"] = usable
    requested = _backend()
    if (requested in _LIBRARIES and not library_loads(requested)) or (requested and requested not in _KNOWN):
        os.environ["MUJOCO_GL"] = "disabled"
        try:
            import mujoco
        finally:
            os.environ["MUJOCO_GL"] = requested
    else:
        import mujoco  # noqa: F401


def create_context(width: int, height: int) -> Any:
    """Open an OpenGL context of the backend that MUJOCO_GL names, large enough for `width` x `height` pixels.

    Raises:
        InputError: if no context can be opened; the message names the Debian packages to install.
    """
    global _opened_by
    os.environ.setdefault("LP_NUM_THREADS", "0")  # Mesa then draws in this thread: small images wait for no others
    backend = _backend()
    if _opened_by not in (None, os.getpid()):
        raise InputError(
            "OpenGL was opened before this process was forked, and would hang; start worker processes with 'spawn' or "
            "'forkserver', for instance AsyncVectorEnv(..., context='spawn')."
        )
    if backend in _OFF:
        raise InputError(
            f"Rendering is switched off by MUJOCO_GL={backend}; unset it, or use obs_type='state' without rendering."
        )
    if backend and backend not in _KNOWN:
        raise InputError(f"MUJOCO_GL is {backend!r}, which is no OpenGL backend here; unset it, or use egl or osmesa.")
    if not backend and _headless():
        raise no_opengl("neither an EGL nor an OSMesa library was found")
    if backend in _LIBRARIES and not library_loads(backend):
        raise no_opengl("its library cannot be loaded")
    try:
        if backend == "egl":
            from mujoco.egl import GLContext
        elif backend == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco.gl_context import GLContext
        context = GLContext(width, height)
        context.make_current()
    except Exception as error:  # PyOpenGL raises AttributeError, TypeError and its own types for a missing driver
        raise no_opengl(str(error)) from error
    _opened_by = os.getpid()
    return context


def no_opengl(reason: str) -> InputError:
    """The error for a machine without a usable OpenGL."""
    backend, display = _backend(), os.environ.get("DISPLAY")
    packages = _PACKAGES.get(backend, " or ".join(_PACKAGES.values()))
    if display and backend not in _LIBRARIES and platform.system() == "Linux":
        return InputError(
            f"Images cannot be rendered on the display DISPLAY={display} ({reason.strip().rstrip('.')}): set "
            "MUJOCO_GL=egl, which needs none, or use obs_type='state' without rendering."
        )
    return InputError(
        f"Images cannot be rendered with MUJOCO_GL={backend or '(unset)'} ({reason.strip().rstrip('.')}): install a "
        f"software renderer (Debian, Ubuntu: apt-get install {packages}) and unset MUJOCO_GL, or use "
        "obs_type='state' without rendering."
    )


def _backend() -> str:
    return os.environ.get("MUJOCO_GL", "").strip().lower()


def _headless() -> bool:
    return platform.system() == "Linux" and not os.environ.get("DISPLAY")
