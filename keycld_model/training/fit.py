"""Stage 2: fit the Lagrangian to the keypoints, first on short windows, then on whole trajectories."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_model.modules import Parts
from keycld_model.places import to_keypoints, to_masses
from keycld_model.state_estimation import estimate_state
from keycld_model.training.data import TrainingData
from keycld_model.training.identification import identify
from keycld_model.training.keypoint_tables import keypoint_table, local_polynomials
from keycld_model.training.stage import Batch, Context, Stage, Variables


@dataclass(frozen=True, kw_only=True)
class _Fit(Stage):
    """What both ways of fitting share.

    Attributes:
        huber: deviation in image units from which the loss grows linearly.
        learn_pivot: also learn where the fixed pivot is.
        linear: of V and g train only the linear terms, if they have any.
    """

    name: str = "fit"
    trained: tuple[str, ...] = ("dynamics", "rod_scale")
    clip: float | None = 10.0
    huber: float = 0.03
    learn_pivot: bool = False
    linear: bool = False

    def _loss(
        self, parts: Parts, variables: Variables, x: Array, v: Array, actions: Array, keypoints: Array
    ) -> tuple[Array, dict[str, Array]]:
        """Huber distance in percent of an image unit, where the keypoints were measured, not where the masses are."""
        dynamics = dict(variables["dynamics"])
        if not self.learn_pivot:
            dynamics["pivot"] = jax.lax.stop_gradient(dynamics["pivot"])
        if self.linear and parts.config.networks.identifiable:
            for name in ("potential", "input"):
                net = dynamics[name]
                dynamics[name] = {k: net[k] if k == "linear" else jax.lax.stop_gradient(net[k]) for k in net}
        model = parts.dynamics({"dynamics": dynamics})

        def one(x: Array, v: Array, u: Array) -> Array:
            return model.rollout(x, v, u, parts.config.timestep)[0]

        positions = jax.vmap(one)(x, v, actions)
        seen = to_keypoints(parts.config.mechanism, variables, positions)
        error = (seen - keypoints).reshape(*seen.shape[:-1], -1, 2)
        distance = jnp.sqrt(jnp.sum(error**2, axis=-1) + 1e-8)
        huber = jnp.where(distance < self.huber, distance**2 / (2 * self.huber), distance - self.huber / 2)
        return 100 * jnp.mean(huber), {"distance": jnp.mean(distance), "distance_end": jnp.mean(distance[:, -1])}


@dataclass(frozen=True, kw_only=True)
class FitWindows(_Fit):
    """Short rollouts that start from local polynomials of the keypoints; needs no idea of the motion.

    Attributes:
        window: frames per rollout.
    """

    window: int = 6

    def enter(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Take the constants of the constraints from the keypoints."""
        keypoints = keypoint_table(parts, variables, data)
        level = mean_level(parts, variables, keypoints)
        there = jnp.zeros(parts.config.mechanism.num_keypoints)
        return {**variables, "dynamics": {**variables["dynamics"], "level": level}, "rod_scale": there, "lean": there}

    def prepare(self, parts: Parts, variables: Variables, data: TrainingData) -> Context:
        """Keypoints and their local polynomials."""
        keypoints = keypoint_table(parts, variables, data)
        x, v = local_polynomials(keypoints, data.timestep)
        return {"keypoints": keypoints, "x": x, "v": v}

    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """Windows from anywhere."""
        n = rng.integers(0, data.num_sequences, self.batch)
        t = rng.integers(0, data.length - self.window + 1, self.batch)
        frames = t[:, None] + np.arange(self.window)
        return {
            "keypoints": context["keypoints"][n[:, None], frames],
            "actions": data.actions[n[:, None], frames[:, :-1]],
            "x": context["x"][n, t],
            "v": context["v"][n, t],
        }

    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Mean Huber distance over the window; each window keeps its own measured lengths."""
        x, v = (to_masses(parts.config.mechanism, variables, batch[name]) for name in ("x", "v"))
        return self._loss(parts, variables, x, v, batch["actions"], batch["keypoints"])


@dataclass(frozen=True, kw_only=True)
class FitTrajectories(_Fit):
    """Whole trajectories with a free initial state each.

    Fifty noisy keypoints determine the four or so numbers of an initial state far better than any pair of frames.

    Attributes:
        portion: fraction of each sequence to follow, from its first frame; grows from stage to stage.
        restart: estimate the initial states anew from the first frames.
        slide: let keypoints move along their rods.
        sparse: the Gauss-Newton steps let motors act on few keypoints.
        acting: then they leave out where motors do not act, and keypoints may lean along their rails; see `identify`.
        identify: at most this many Gauss-Newton steps on masses, slide and linear terms, if there are any, before the
            optimiser's; as many again if `acting`.
    """

    steps: int = 0
    learning_rate: float = 1e-3
    batch: int = 64
    trained: tuple[str, ...] = ("dynamics", "rod_scale", "trajectories")
    portion: float = 1.0
    restart: bool = False
    slide: bool = True
    sparse: bool = False
    acting: bool = False
    identify: int = 0

    def frames(self, data: TrainingData) -> int:
        """Frames to follow."""
        return max(min(data.length, 8), round(self.portion * data.length))

    def enter(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Initial states by least squares, from scratch or from where they are."""
        measured = jnp.asarray(keypoint_table(parts, variables, data))
        keypoints = to_masses(parts.config.mechanism, variables, measured)
        first = self.frames(data)
        if self.restart:
            level = mean_level(parts, variables, np.asarray(keypoints))
            variables = {**variables, "dynamics": {**variables["dynamics"], "level": level}}
            first = min(first, 12)
        start = None if self.restart else variables["trajectories"]
        fitted = fit_states(parts, variables, keypoints[:, :first], data.actions[:, : first - 1], start)
        variables = {**variables, "trajectories": fitted}
        if not (self.identify and parts.config.networks.identifiable):
            return variables
        frames = self.frames(data)
        actions = data.actions[:, : frames - 1]
        return identify(
            parts, variables, measured[:, :frames], actions, self.identify, self.slide, self.sparse, self.acting
        )

    def prepare(self, parts: Parts, variables: Variables, data: TrainingData) -> Context:
        """Keypoints of all frames."""
        return {"keypoints": keypoint_table(parts, variables, data)[:, : self.frames(data)]}

    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """Different sequences."""
        n = rng.permutation(data.num_sequences)[: self.batch]
        frames = context["keypoints"].shape[1]
        return {"n": n, "keypoints": context["keypoints"][n], "actions": data.actions[n, : frames - 1]}

    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Mean Huber distance over the trajectory."""
        if not self.slide:
            variables = {**variables, "rod_scale": jax.lax.stop_gradient(variables["rod_scale"])}
        start = variables["trajectories"]
        x, v = start["x"][batch["n"]], start["v"][batch["n"]]
        return self._loss(parts, variables, x, v, batch["actions"], batch["keypoints"])


def fit_states(
    parts: Parts, variables: Variables, keypoints: Array, actions: NDArray[np.float32], start: Variables | None
) -> dict[str, Array]:
    """Initial states {"x", "v"} `[N, n]` of the trajectories that fit keypoints `[N, T, n]` best.

    A sequence keeps the state it came with (its first keypoints at rest, if none) unless the fit is closer.
    """

    @jax.jit
    def fit(dynamics: Variables, y: Array, u: Array, start: Variables | None) -> dict[str, Array]:
        model, h = parts.dynamics({"dynamics": dynamics}), parts.config.timestep

        def one(y: Array, u: Array, x: Array, v: Array) -> tuple[Array, Array]:
            def error(x: Array, v: Array) -> Array:
                return jnp.nan_to_num(jnp.sum(jnp.abs(model.rollout(x, v, u, h)[0] - y)), nan=jnp.inf)

            new = estimate_state(model, y, u, h, start=None if start is None else (x, v))
            better = error(*new) < error(x, v)
            return jnp.where(better, new[0], x), jnp.where(better, new[1], v)

        old = {"x": y[:, 0], "v": jnp.zeros_like(y[:, 0])} if start is None else start
        x, v = jax.vmap(one)(y, u, old["x"], old["v"])
        return {"x": x, "v": v}

    return fit(variables["dynamics"], keypoints, actions, start)


def mean_level(parts: Parts, variables: Variables, keypoints: np.ndarray) -> Array:
    """Constants of the constraints, `[c]`: means over measured keypoints `[N, T, n]`."""
    dynamics = parts.dynamics(variables)
    return jnp.mean(jax.vmap(dynamics.constraint)(jnp.asarray(keypoints.reshape(-1, keypoints.shape[-1]))), axis=0)
