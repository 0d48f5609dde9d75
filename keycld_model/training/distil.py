"""Stage 3: teach both networks the trajectories that the Lagrangian explains."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.modules import Parts, as_float
from keycld_model.training.data import TrainingData
from keycld_model.training.keypoint_tables import trajectories, trust
from keycld_model.training.stage import Batch, Context, Stage, Variables


@dataclass(frozen=True, kw_only=True)
class Distil(Stage):
    """Regress keypoints on, and draw frames from, the fitted trajectories.

    A trajectory averages the errors of all its frames, so it is a better label than any single frame's keypoints.

    Attributes:
        keypoint_weight: weight of the distance to the trajectory, per image unit.
    """

    name: str = "distil"
    trained: tuple[str, ...] = ("estimator", "renderer")
    keypoint_weight: float = 30.0

    def prepare(self, parts: Parts, variables: Variables, data: TrainingData) -> Context:
        """Positions `[N*T, n]` on the trajectories, and how much each frame counts."""
        target = trajectories(parts, variables, data)
        # Weights stay those of the keypoints at the start of the stage, which "trust" remembers.
        weight = np.asarray(variables["trust"])
        n = target.shape[-1]
        return {"target": target.reshape(-1, n), "weight": weight.reshape(-1)}

    def enter(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Compare trajectories and keypoints once, before the keypoints change."""
        trusted = trust(parts, variables, data, trajectories(parts, variables, data))
        return {**variables, "trust": jnp.asarray(trusted, jnp.float32)}

    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """Frames from anywhere."""
        i = rng.integers(0, len(data.flat_frames), self.batch)
        return {"frames": data.flat_frames[i], "target": context["target"][i], "weight": context["weight"][i]}

    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Weighted squared error per frame plus weighted distance of the keypoints."""
        frames, target = as_float(batch["frames"]), batch["target"]
        x = parts.keypoints(variables, frames)
        reconstruction = jnp.sum((parts.render(variables, target) - frames) ** 2, axis=(1, 2, 3))
        error = (x - target).reshape(x.shape[0], -1, 2)
        distance = jnp.sum(jnp.sqrt(jnp.sum(error**2, axis=-1) + 1e-6), axis=-1)
        loss = jnp.mean(batch["weight"] * (reconstruction + self.keypoint_weight * distance))
        metrics = {
            "reconstruction": jnp.mean(reconstruction),
            "distance": jnp.mean(distance) / error.shape[1],
            "trusted": jnp.mean(batch["weight"]),
            "keypoint_spread": jnp.std(x, 0),
        }
        return loss, metrics

    def leave(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """The keypoints are now where the masses are."""
        there = jnp.zeros_like(variables["rod_scale"])
        return {**variables, "rod_scale": there, "lean": there}
