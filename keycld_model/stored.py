"""Stored models: inside the package, or in a folder of one's own."""

import difflib
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from keycld_envs import system_of
from keycld_envs.errors import InputError
from keycld_envs.mechanism_file import is_mechanism_file
from keycld_model.checkpoint import WEIGHTS, flatten, read_checkpoint
from keycld_model.config import ModelConfig
from keycld_model.modules import Parameters, Parts
from keycld_model.uncertainty import Uncertainty

LARGEST = 1e6
"""No weight of a network for images between 0 and 1 is larger by far."""


def shipped_models() -> dict[str, Path]:
    """Name and folder of every model inside the package."""
    root = Path(str(resources.files("keycld_model"))) / "weights"
    return {folder.name: folder for folder in sorted(root.iterdir()) if folder.is_dir()} if root.is_dir() else {}


def find_model(source: str) -> Path:
    """The folder of a checkpoint; a folder named like a shipped model counts if it holds one."""
    folder, shipped = Path(source), shipped_models()
    if is_mechanism_file(source):
        raise InputError(f"There are no weights for {source}; `keycld train` makes some, name their folder: --weights.")
    name = source
    if source not in shipped and ("/" in source or ":" in source) and not folder.exists():
        with suppress(InputError):
            name = system_of(source).name
    if name in shipped and not (folder / WEIGHTS).is_file():
        return shipped[name]
    if folder.exists():
        return folder
    similar = difflib.get_close_matches(source.lower(), shipped, n=1)
    guess = f" (did you mean {similar[0]}?)" if similar else ""
    raise InputError(
        f"There is no checkpoint {source!r}{guess}; give the path of a checkpoint folder or one of the shipped models: "
        f"{', '.join(sorted(shipped)) or 'none in this installation'}."
    )


def read_model(folder: Path) -> tuple[ModelConfig, Parameters, Uncertainty | None, dict[str, Any]]:
    """Configuration, parameters, how uncertain they are, and what the checkpoint says about its training.

    Raises:
        InputError: if it is damaged, or of another version.
    """
    tensors, meta = read_checkpoint(folder)
    if "config" not in meta or "model" not in tensors:
        raise InputError(f"{folder} is not a world model; name the checkpoint folder that `keycld train` wrote.")
    try:
        config = ModelConfig.from_dict(meta["config"])
    except InputError as error:
        raise InputError(
            f"{folder}: {str(error).rstrip('.')}; it was written by another version, train again."
        ) from error
    _check_parameters(folder, tensors["model"], Parts(config).shapes())
    uncertainty = _uncertainty(folder, tensors["uncertainty"], Parts(config)) if "uncertainty" in tensors else None
    return config, jax.tree.map(jnp.asarray, tensors["model"]), uncertainty, meta


def _uncertainty(folder: Path, tensors: Any, parts: Parts) -> Uncertainty:
    try:
        return Uncertainty.from_tensors(tensors, parts)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder} holds uncertainties of another model ({error}); train again.") from error


def _check_parameters(folder: Path, found: Parameters, expected: Parameters) -> None:
    """Refuse arrays that are not those of a configuration, or that no training ends with."""
    kinds, asked = (jax.tree.map(lambda a: (a.shape, np.dtype(a.dtype)), tree) for tree in (found, expected))
    if kinds != asked:
        raise InputError(f"{folder} does not hold the arrays that its own configuration asks for; train again.")
    for name, array in flatten(found).items():
        if np.abs(array).max(initial=0.0) > LARGEST:
            raise InputError(f"{folder}: {name} holds numbers beyond {LARGEST:g}; train again or restore a copy.")
