"""Stage 3: teach both networks the trajectories that the Lagrangian explains."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.modules import Parts, as_float
from keycld_model.training.composed import composed
from keycld_model.training.data import TrainingData
from keycld_model.training.keypoint_tables import TRUSTED, trajectories, trust
from keycld_model.training.stage import Batch, Context, Stage, Variables


@dataclass(frozen=True, kw_only=True)
class Distil(Stage):
    """Regress keypoints on, and draw frames from, the fitted trajectories.

    A trajectory averages the errors of all its frames, so it is a better label than any single frame's keypoints.

    Attributes:
        keypoint_weight: weight of the distance to the trajectory, per image unit.
        composed: frames per step, beside those of the recordings, that pictures of rigid parts draw of poses that no
            recording has; they teach the estimator.
    """

    name: str = "distil"
    trained: tuple[str, ...] = ("estimator", "renderer")
    keypoint_weight: float = 30.0
    composed: int = 0

    def prepare(self, parts: Parts, variables: Variables, data: TrainingData) -> Context:
        """Positions `[N*T, n]` on the trajectories, and how much each frame counts."""
        target = trajectories(parts, variables, data)
        # Weights stay those of the keypoints at the start of the stage, which "trust" remembers.
        weight = np.asarray(variables["trust"])
        target, weight = target.reshape(-1, target.shape[-1]), weight.reshape(-1)
        if not self.composed:
            return {"target": target, "weight": weight}
        followed = target[weight > TRUSTED] if (weight > TRUSTED).any() else target
        rng = np.random.default_rng(0)
        pivot = np.asarray(variables["dynamics"]["pivot"])
        return {"target": target, "weight": weight, "poses": composed(parts.config.mechanism, followed, pivot, rng)}

    def enter(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Compare trajectories and keypoints once, before the keypoints change."""
        trusted = trust(parts, variables, data, trajectories(parts, variables, data))
        return {**variables, "trust": jnp.asarray(trusted, jnp.float32)}

    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """Frames from anywhere."""
        i = rng.integers(0, len(data.flat_frames), self.batch)
        batch = {"frames": data.flat_frames[i], "target": context["target"][i], "weight": context["weight"][i]}
        if self.composed:
            batch["poses"] = context["poses"][rng.integers(0, len(context["poses"]), self.composed)]
        return batch

    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Weighted squared error per frame plus weighted distance of the keypoints."""
        frames, target = as_float(batch["frames"]), batch["target"]
        shown = frames
        if self.composed:
            poses = batch["poses"].reshape(self.composed, -1, 2)
            drawn = parts.appearance(variables)(poses, variables["dynamics"]["pivot"])
            shown = jnp.concatenate([frames, jax.lax.stop_gradient(jnp.clip(drawn, 0.0, 1.0))])
        found = parts.keypoints(variables, shown)
        x = found[: len(frames)]
        reconstruction = jnp.sum((parts.render(variables, target) - frames) ** 2, axis=(1, 2, 3))
        distance = _distance(x - target)
        loss = jnp.mean(batch["weight"] * (reconstruction + self.keypoint_weight * distance))
        if self.composed:
            loss += self.keypoint_weight * jnp.mean(_distance(found[len(frames) :] - batch["poses"]))
        metrics = {
            "reconstruction": jnp.mean(reconstruction),
            "distance": 2 * jnp.mean(distance) / x.shape[1],
            "trusted": jnp.mean(batch["weight"]),
            "keypoint_spread": jnp.std(x, 0),
        }
        return loss, metrics

    def leave(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """The keypoints are now where the masses are."""
        there = jnp.zeros_like(variables["rod_scale"])
        return {**variables, "rod_scale": there, "lean": there}


def _distance(error: Array) -> Array:
    """`[B]`, summed over keypoints, of errors `[B, n]`."""
    each = error.reshape(error.shape[0], -1, 2)
    return jnp.sum(jnp.sqrt(jnp.sum(each**2, axis=-1) + 1e-6), axis=-1)
