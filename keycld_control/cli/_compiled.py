"""Compiled programs, kept from one command to the next."""

import os
from pathlib import Path


def keep_compiled() -> None:
    """Let JAX keep what it compiles in the user's cache folder; before JAX is imported, for child processes too."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "keycld" / "compiled"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
