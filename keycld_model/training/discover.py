"""Stage 1: find the moving parts. Single frames, reconstruction, and constraints that should stay constant."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.modules import Parts, as_float
from keycld_model.training.data import TrainingData
from keycld_model.training.stage import Batch, Context, Stage, Variables


@dataclass(frozen=True, kw_only=True)
class Discover(Stage):
    """Autoencode single frames through the keypoints (KeyCLD paper, equation 10).

    The variance over the batch of every rod's length and every slider's offset is penalised: lengths are unknown, but
    they are the same in all frames.

    Attributes:
        constraint_weight: weight of that variance, per squared image unit.
    """

    name: str = "discover"
    trained: tuple[str, ...] = ("estimator", "renderer")
    constraint_weight: float = 50.0

    def enter(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Start both networks from the mean frame."""
        mean = jnp.asarray(data.mean_frame)
        estimator, renderer = dict(variables["estimator"]), dict(variables["renderer"])
        if "background" in estimator:
            estimator["background"] = mean
        if "background" in renderer:
            clipped = jnp.clip(mean, 0.02, 0.98)
            renderer["background"] = jnp.log(clipped / (1 - clipped))
        return {**variables, "estimator": estimator, "renderer": renderer}

    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """Frames from anywhere."""
        frames = data.flat_frames
        return {"frames": frames[rng.integers(0, len(frames), self.batch)]}

    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Squared error per frame plus weighted variance of the constraints."""
        frames = as_float(batch["frames"])
        x = parts.keypoints(variables, frames)
        reconstruction = jnp.mean(jnp.sum((parts.render(variables, x) - frames) ** 2, axis=(1, 2, 3)))
        spread = constraint_variance(parts, variables, x)
        metrics = {"reconstruction": reconstruction, "constraint_variance": spread, "keypoint_spread": jnp.std(x, 0)}
        return reconstruction + self.constraint_weight * spread, metrics


def constraint_variance(parts: Parts, variables: Variables, x: Array) -> Array:
    """Variance of rod lengths and slider offsets over positions `[B, n]`, summed; squared image units."""
    phi = jax.vmap(parts.dynamics(variables).constraint)(x)
    rods = len(parts.config.mechanism.rods)
    lengths = jnp.concatenate([jnp.sqrt(2 * phi[:, :rods] + 1e-6), phi[:, rods:]], axis=1)
    return jnp.sum(jnp.var(lengths, axis=0))
