"""`WorldModel`: keypoints, constrained Lagrangian and renderer, ready to use."""

import difflib
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from keycld_envs import system_of
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_model.checkpoint import WEIGHTS, flatten, read_checkpoint, write_checkpoint
from keycld_model.config import ModelConfig
from keycld_model.modules import Parameters, Parts, as_float
from keycld_model.physics import mass_matrix
from keycld_model.state_estimation import estimate_state, refine_state

Floats = NDArray[np.float32]
LARGEST = 1e6
"""No weight of a network for images between 0 and 1 is larger by far."""
CONTEXT_FRAMES = 5
"""Frames from which a prediction starts unless told otherwise."""


@dataclass(frozen=True)
class Prediction:
    """What a model expects to happen.

    Attributes:
        frames: [T, H, W, 3] float32, 0 to 1; frame 0 is the first given frame, as the model sees it.
        keypoints: [T, K, 2], image units.
        velocities: [T, K, 2], image units per second.
    """

    frames: Floats
    keypoints: Floats
    velocities: Floats


@dataclass(frozen=True, eq=False)
class WorldModel:
    """A learned world model of one mechanism.

    Positions are in image units: pixel centres span -1 to 1, x to the right, y up. Time is in seconds. Forces and
    energies are per total mass: sum(masses) = 1 fixes the scale that motion alone leaves open.

    Attributes:
        config: architecture, mechanism, seconds between frames, image size.
        parameters: nested dictionary of arrays.
        name: where the model came from: a shipped name or a path.
        meta: what the checkpoint says about its training.
    """

    config: ModelConfig
    parameters: Parameters
    name: str = "untitled"
    meta: dict[str, Any] | None = None

    @classmethod
    def load(cls, source: str | os.PathLike[str]) -> "WorldModel":
        """Load shipped weights by a system's name or its environment's id, or a checkpoint folder.

        Args:
            source: "pendulum", "cartpole", "acrobot", "KeyCLD/Acrobot-v0", ..., or the path of a checkpoint.

        Raises:
            InputError: if there is no such model, or it is damaged or of another version.
        """
        folder = _find(os.fspath(source))
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
        return cls(config, jax.tree.map(jnp.asarray, tensors["model"]), os.fspath(source), meta)

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write a checkpoint (safetensors and JSON) that `load` reads."""
        meta = {k: v for k, v in (self.meta or {}).items() if k not in ("schema", "sha256", "versions", "config")}
        return write_checkpoint(folder, {"model": self.parameters}, {"config": self.config.to_dict(), **meta})

    def with_parameters(self, parameters: Parameters) -> "WorldModel":
        """The same architecture with other parameters, sharing what is compiled already."""
        other = replace(self, parameters=parameters)
        for name in ("parts", "_rollouts", "_batched", "_keypoints"):
            other.__dict__[name] = getattr(self, name)
        return other

    # What the model is of -------------------------------------------------------------------------------------------

    @property
    def system(self) -> str | None:
        """Environment id the model was trained on, or None."""
        return self.config.system

    @property
    def mechanism(self) -> Mechanism:
        """Keypoints, rods and sliders."""
        return self.config.mechanism

    @property
    def constrained(self) -> bool:
        """Rods and sliders hold the masses; in KeyCLD-NC and NODE2 nothing does."""
        return self.config.networks.motion == "constrained"

    @property
    def timestep(self) -> float:
        """Seconds between frames."""
        return self.config.timestep

    @property
    def image_shape(self) -> tuple[int, int]:
        """(H, W), pixels."""
        return self.config.image_shape

    @cached_property
    def masses(self) -> Floats:
        """[K] point masses, fractions of the total."""
        return np.asarray(self.parts.lagrangian(self.parameters).masses)

    @cached_property
    def level(self) -> Floats:
        """[c] constants of the constraints: half squared rod lengths, slider offsets; image units."""
        return np.asarray(self.parameters["dynamics"]["level"])

    @cached_property
    def pivot(self) -> Floats:
        """[2] position of the fixed pivot, image units."""
        return np.asarray(self.parameters["dynamics"]["pivot"])

    # Pure functions of one frame or state, to be traced into larger programs ----------------------------------------

    @cached_property
    def parts(self) -> "Parts":
        """The modules, to be applied to `parameters`."""
        return Parts(self.config)

    def keypoints_fn(self, image: Array) -> Array:
        """Keypoints `[n]` of one image `[H, W, 3]`, uint8 or float in 0 to 1. JAX-traceable."""
        return self.parts.keypoints(self.parameters, image[None])[0]

    def potential_energy_fn(self, x: Array) -> Array:
        """V (scalar) of positions `[n]`. JAX-traceable."""
        return self.parts.lagrangian(self.parameters).potential_energy(x)

    def input_matrix_fn(self, x: Array) -> Array:
        """g `[n, m]` of positions `[n]`. JAX-traceable."""
        return self.parts.lagrangian(self.parameters).input_matrix(x)

    def render_fn(self, x: Array) -> Array:
        """Image `[H, W, 3]` in 0 to 1 of positions `[n]`. JAX-traceable."""
        return self.parts.render(self.parameters, x[None])[0]

    # The same for arrays with any leading dimensions ----------------------------------------------------------------

    def keypoints(self, images: ArrayLike) -> Floats:
        """Find the keypoints.

        Args:
            images: [..., H, W, 3], uint8, or float in 0 to 1.

        Returns:
            [..., K, 2], image units.

        Raises:
            InputError: if the images have another size or hold NaN.
        """
        array = self._images(images)
        flat = self._keypoints(self.parameters, array.reshape(-1, *array.shape[-3:]))
        return flat.reshape(*array.shape[:-3], self.mechanism.num_keypoints, 2)

    def render(self, x: ArrayLike) -> Floats:
        """Draw frames [..., H, W, 3] (0 to 1) of keypoints [..., K, 2], image units."""
        return self._map("render", x)

    def potential_energy(self, x: ArrayLike) -> Floats:
        """V(x) of keypoints [..., K, 2], image units: [...], image units squared per second squared, per total mass."""
        return self._map("potential_energy", x)

    def input_matrix(self, x: ArrayLike) -> Floats:
        """g(x) of keypoints [..., K, 2], image units: [..., 2K, m], image units per second squared, per unit of action.

        A force per total mass.
        """
        return self._map("input_matrix", x)

    def mass_matrix(self) -> Floats:
        """M, [2K, 2K], diagonal, in units of the total mass, so of trace 2: every mass counts in x and in y."""
        return np.asarray(mass_matrix(jnp.asarray(self.masses)))

    def constraint(self, x: ArrayLike) -> Floats:
        """Phi(x) - level of keypoints [..., K, 2], image units: [..., c], zero where the mechanism can be.

        Rods come first, in image units squared (half a squared length), then sliders, in image units.
        """
        return self._map("constraint", x)

    def predict(self, images: ArrayLike, actions: ArrayLike, steps: int) -> Prediction:
        """Predict a sequence from its first frames.

        The state at the first frame is the least-squares fit of a trajectory of the model to all given frames, first to
        their keypoints, then to their pixels; the model then runs on its own.

        Args:
            images: [C, H, W, 3], the first C >= 2 frames, uint8 or float in 0 to 1.
            actions: [steps-1, m] or longer; action i acts between frames i and i+1, frame 0 being the first given one.
            steps: number of frames to predict, T; the first C of them are the given frames as the model sees them.

        Raises:
            InputError: if there are fewer than two frames, too few actions, or arrays of other sizes or with NaN.
        """
        frames = self._images(images)
        if frames.ndim != 4 or not len(frames) >= 2:
            raise InputError(f"images has shape {frames.shape}; a prediction starts from [C, H, W, 3], C at least 2.")
        if steps < len(frames):
            raise InputError(f"steps is {steps}, but {len(frames)} frames are given; ask for at least as many.")
        keypoints, velocities = self.rollout(frames[None], self._actions(actions, steps - 1)[None])
        return Prediction(self.render(keypoints[0]), keypoints[0], velocities[0])

    def rollout(self, images: ArrayLike, actions: ArrayLike, refine: bool = True) -> tuple[Floats, Floats]:
        """Predict the keypoints of many sequences from their first frames.

        Args:
            images: [N, C, H, W, 3], C >= 2, uint8 or float in 0 to 1.
            actions: [N, T-1, m].
            refine: fit the initial state to the pixels, not only to the keypoints.

        Returns:
            Keypoints and velocities [N, T, K, 2], image units (per second).

        Raises:
            InputError: if the arrays do not fit together or the model, or hold NaN.
        """
        frames, u = self._images(images), np.asarray(actions, np.float32)
        if frames.ndim != 5 or u.ndim != 3 or len(frames) != len(u) or not 2 <= frames.shape[1] <= u.shape[1] + 1:
            raise InputError(
                f"images has shape {frames.shape} and actions {u.shape}; a rollout needs [N, C, H, W, 3] and "
                "[N, T-1, m] with 2 <= C <= T."
            )
        u = np.stack([self._actions(a, len(a)) for a in u])
        function = self._rollouts[refine]
        states = [function(self.parameters, z, a) for z, a in zip(frames, u, strict=True)]
        shape = (len(frames), u.shape[1] + 1, self.mechanism.num_keypoints, 2)
        x, v = (np.stack([np.asarray(s[i]) for s in states]).reshape(shape) for i in (0, 1))
        return x, v

    @cached_property
    def _rollouts(self) -> dict[bool, Callable[[Parameters, ArrayLike, ArrayLike], tuple[Array, Array]]]:
        h = self.timestep

        def one(parameters: Parameters, frames: Array, u: Array, refine: bool) -> tuple[Array, Array]:
            dynamics, first = self.parts.dynamics(parameters), u[: frames.shape[0] - 1]
            keypoints = self.parts.keypoints(parameters, frames)
            state = estimate_state(dynamics, keypoints, first, h, fine=True)
            if refine:
                draw = partial(self.parts.render, parameters)
                state = refine_state(dynamics, draw, as_float(frames), keypoints, first, h, state)
            return dynamics.rollout(*state, u, h, fine=True)

        return {refine: jax.jit(partial(one, refine=refine)) for refine in (False, True)}

    @cached_property
    def _keypoints(self) -> Callable[[Parameters, NDArray[Any]], Floats]:
        function = jax.jit(self.parts.keypoints)

        def in_chunks(parameters: Parameters, images: NDArray[Any]) -> Floats:
            return _in_chunks(partial(function, parameters), images)

        return in_chunks

    @cached_property
    def _batched(self) -> dict[str, Callable[[Parameters, ArrayLike], Array]]:
        """Compiled functions of positions `[B, n]`."""
        of, lagrangian = self.parts.dynamics, self.parts.lagrangian
        functions = {
            "potential_energy": lambda p, x: jax.vmap(lagrangian(p).potential_energy)(x),
            "input_matrix": lambda p, x: jax.vmap(lagrangian(p).input_matrix)(x),
            "constraint": lambda p, x: jax.vmap(of(p).constraint)(x) - p["dynamics"]["level"],
            "render": self.parts.render,
        }
        return {name: jax.jit(function) for name, function in functions.items()}

    def _map(self, name: str, x: ArrayLike) -> Floats:
        """Apply a function of positions `[B, n]` to keypoints [..., K, 2]."""
        array = np.asarray(x, np.float32)
        k = self.mechanism.num_keypoints
        if array.shape[-2:] != (k, 2):
            raise InputError(f"x has shape {array.shape}; this model needs keypoints of shape [..., {k}, 2].")
        flat = array.reshape(-1, 2 * k)
        result = _in_chunks(partial(self._batched[name], self.parameters), flat)
        return result.reshape(array.shape[:-2] + result.shape[1:])

    def _images(self, images: ArrayLike) -> NDArray[Any]:
        array = np.asarray(images)
        h, w = self.image_shape
        if array.ndim < 3 or array.shape[-3:] != (h, w, 3):
            raise InputError(f"images has shape {array.shape}; this model needs [..., {h}, {w}, 3].")
        if array.dtype != np.uint8:
            array = array.astype(np.float32)
            if not np.isfinite(array).all() or array.min(initial=0.0) < -1e-3 or array.max(initial=0.0) > 1 + 1e-3:
                raise InputError("images holds values outside 0 to 1, or NaN; give uint8, or floats divided by 255.")
        return array

    def _actions(self, actions: ArrayLike, steps: int) -> Floats:
        array = np.asarray(actions, np.float32)
        m = self.mechanism.num_actions
        if array.ndim != 2 or array.shape[1] != m or len(array) < steps:
            raise InputError(f"actions has shape {array.shape}; {steps + 1} frames need [{steps}, {m}] or longer.")
        bad = np.flatnonzero(~np.isfinite(array[:steps]).all(axis=1))
        if bad.size:
            raise InputError(f"actions[{bad[0]}] is not finite; every action must be a number.")
        return array[:steps]


def _check_parameters(folder: Path, found: Parameters, expected: Parameters) -> None:
    """Refuse arrays that are not those of a configuration, or that no training ends with."""
    kinds, asked = (jax.tree.map(lambda a: (a.shape, np.dtype(a.dtype)), tree) for tree in (found, expected))
    if kinds != asked:
        raise InputError(f"{folder} does not hold the arrays that its own configuration asks for; train again.")
    for name, array in flatten(found).items():
        if np.abs(array).max(initial=0.0) > LARGEST:
            raise InputError(f"{folder}: {name} holds numbers beyond {LARGEST:g}; train again or restore a copy.")


def _in_chunks(function: Callable[[NDArray[Any]], Array], array: NDArray[Any], chunk: int = 64) -> Floats:
    """Apply a function of a batch to a bounded number of rows at a time; none are allowed."""
    if len(array) == 0:
        return np.asarray(function(np.zeros((1, *array.shape[1:]), array.dtype)))[:0]
    return np.concatenate([np.asarray(function(array[i : i + chunk])) for i in range(0, len(array), chunk)])


def _find(source: str) -> Path:
    """The folder of a checkpoint; a folder named like a shipped model counts if it holds one."""
    folder, shipped = Path(source), shipped_models()
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


def shipped_models() -> dict[str, Path]:
    """Name and folder of every model inside the package."""
    root = Path(str(resources.files("keycld_model"))) / "weights"
    return {folder.name: folder for folder in sorted(root.iterdir()) if folder.is_dir()} if root.is_dir() else {}
