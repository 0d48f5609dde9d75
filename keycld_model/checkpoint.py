"""Checkpoints: a folder with `weights.safetensors` and `checkpoint.json`, never pickle."""

import hashlib
import json
import os
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file
from keycld_envs.reading import check_file, parse_json

SCHEMA = "keycld.checkpoint/2"
WEIGHTS, META = "weights.safetensors", "checkpoint.json"
STATE = "state"
"""Folder of a checkpoint of what an unfinished run has reached, below that of the run."""
UNSEALED = "0" * 64
Tree = dict[str, Any]


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, NDArray[Any]]:
    """A nested dictionary of arrays as one level with keys "a/b/c"."""
    flat: dict[str, NDArray[Any]] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}/")
        else:
            flat[f"{prefix}{key}"] = np.asarray(value, order="C")
    return flat


def unflatten(flat: Mapping[str, Any]) -> Tree:
    """The inverse of `flatten`."""
    tree: Tree = {}
    for path, value in flat.items():
        *folders, name = path.split("/")
        node = tree
        for folder in folders:
            node = node.setdefault(folder, {})
        node[name] = value
    return tree


def versions() -> dict[str, str]:
    """Versions of what made a checkpoint."""
    found = {}
    for name in ("keycld", "jax", "flax", "optax", "numpy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def write_checkpoint(folder: str | os.PathLike[str], tensors: Mapping[str, Any], meta: Mapping[str, Any]) -> Path:
    """Write a checkpoint; a kill leaves either the old one or the new one.

    Args:
        folder: created if absent.
        tensors: nested dictionary of arrays.
        meta: JSON-compatible description, stored beside schema and versions.

    Returns:
        The folder.
    """
    folder = Path(folder)
    text = json.dumps({"schema": SCHEMA, "sha256": UNSEALED, **meta, "versions": versions()}, indent=1)
    payload, seal = _sealed(save(flatten(tensors), {"checkpoint": text}))
    with atomic_file(folder / WEIGHTS) as file:
        file.write(payload)
    with atomic_file(folder / META, "w") as file:
        file.write(text.replace(UNSEALED, seal, 1) + "\n")
    return folder


def read_checkpoint(folder: str | os.PathLike[str]) -> tuple[Tree, dict[str, Any]]:
    """Read and check what `write_checkpoint` wrote.

    The weights file holds the description too; it counts, so a kill between the two writes does no harm.

    Returns:
        The nested dictionary of arrays, and the description.

    Raises:
        InputError: if a file is missing, of another version, not as it was written (its SHA-256 is in it), or holds
            numbers that are not finite.
    """
    folder = Path(folder)
    path = folder / WEIGHTS
    if not path.is_file():
        if (folder / STATE / WEIGHTS).is_file():
            raise InputError(f"{folder} holds a training that has not ended; start it again, and it goes on.")
        raise InputError(f"{folder} holds no {WEIGHTS}; name a checkpoint folder, as `keycld train` writes it.")
    try:
        payload = check_file(path).read_bytes()
        header = parse_json(payload[8 : 8 + int.from_bytes(payload[:8], "little")])
        meta = {**parse_json(header["__metadata__"]["checkpoint"])}
        if meta.get("schema") == SCHEMA:
            unsealed = payload.replace(meta["sha256"].encode(), UNSEALED.encode(), 1)
            if _sealed(unsealed)[0] != payload:
                raise ValueError("its checksum is another")
        tensors = load(payload)
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is damaged ({error}); train again or restore a copy.") from error
    if meta.get("schema") != SCHEMA:
        writer = meta.get("versions", {}).get("keycld", "(unknown)")
        raise InputError(
            f"{path} has schema {meta.get('schema')!r}, this version reads {SCHEMA!r}; use keycld {writer}, which "
            "wrote it, or train again."
        )
    for name, array in tensors.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise InputError(f"{path}: {name} holds numbers that are not finite; train again or restore a copy.")
    return unflatten(tensors), meta


def check_same_run(folder: str | os.PathLike[str], kept: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Refuse to go on with a run of other settings.

    Raises:
        InputError: if any that is wanted was kept otherwise.
    """
    for key, value in wanted.items():
        if kept.get(key) != value:
            raise InputError(
                f"{folder} holds a run with another {key}; continue it with the same settings and data, or "
                "choose another --out."
            )


def _sealed(payload: bytes) -> tuple[bytes, str]:
    """A safetensors file with its SHA-256 in place of `UNSEALED`, with which it is reckoned, and the SHA-256."""
    seal = hashlib.sha256(payload).hexdigest()
    return payload.replace(UNSEALED.encode(), seal.encode(), 1), seal
