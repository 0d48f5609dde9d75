"""A mechanism in a Python file of its own: what stands in it under the name `mechanism`."""

import os
import runpy
from pathlib import Path

from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism

NAME = "mechanism"


def read_mechanism(path: str | os.PathLike[str]) -> Mechanism:
    """Run a Python file and take its variable `mechanism`.

    Args:
        path: a file that ends in .py, such as

            from keycld_envs import Mechanism, Rod

            mechanism = Mechanism(num_keypoints=1, num_actions=0, rods=(Rod(None, 0),))

    Raises:
        InputError: if there is no such file, it does not run, or `mechanism` is missing or is no `Mechanism`.
    """
    path = Path(path)
    if path.suffix != ".py" or not path.is_file():
        raise InputError(f"{path} is no Python file; name one that declares a mechanism, such as examples/pendulum.py.")
    try:
        found = runpy.run_path(str(path)).get(NAME)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{path} does not run ({type(error).__name__}: {error}); correct it.") from error
    if not isinstance(found, Mechanism):
        has = "has no variable" if found is None else f"has a {type(found).__name__} under the name"
        raise InputError(f"{path} {has} {NAME!r}; set {NAME} = keycld_envs.Mechanism(...) in it.")
    return found
