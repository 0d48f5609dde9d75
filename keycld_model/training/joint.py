"""The paper's training: reconstruction and collocation of accelerations, all at once."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_model.modules import Parts, as_float
from keycld_model.training.data import TrainingData
from keycld_model.training.fit import mean_level
from keycld_model.training.keypoint_tables import keypoint_table
from keycld_model.training.stage import Batch, Context, Stage, Variables


@dataclass(frozen=True, kw_only=True)
class Joint(Stage):
    """One whole sequence per step (KeyCLD paper, equations 10 to 13).

    Attributes:
        dynamics_weight: lambda, the weight of the squared acceleration error.
    """

    name: str = "joint"
    trained: tuple[str, ...] = ("estimator", "renderer", "dynamics")
    one_cycle: bool = False
    clip: float | None = None
    dynamics_weight: float = 5e-4

    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """Whole sequences."""
        n = rng.integers(0, data.num_sequences, self.batch)
        return {"frames": data.frames[n], "actions": data.actions[n]}

    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Reconstruction plus lambda times the acceleration error, sums over a sequence divided by its length."""
        frames = as_float(batch["frames"])
        b, t = frames.shape[:2]
        flat = frames.reshape(b * t, *frames.shape[2:])
        x = parts.keypoints(variables, flat)
        reconstruction = jnp.sum((parts.render(variables, x) - flat) ** 2) / (b * t)
        learned = variables["dynamics"]
        fixed = {**learned, "pivot": jax.lax.stop_gradient(learned["pivot"])}  # declared, not learned
        dynamics, h = parts.dynamics({"dynamics": fixed}), parts.config.timestep
        x = x.reshape(b, t, -1)
        v = (x[:, 2:] - x[:, :-2]) / (2 * h)
        measured = (v[:, 2:] - v[:, :-2]) / (2 * h)
        inner = jax.vmap(jax.vmap(dynamics.acceleration))(x[:, 2:-2], v[:, 1:-1], batch["actions"][:, 2:-1])
        error = jnp.sum((measured - inner) ** 2) / (b * t)
        metrics = {"reconstruction": reconstruction, "acceleration": error, "keypoint_spread": jnp.std(x, (0, 1))}
        return reconstruction + self.dynamics_weight * error, metrics

    def leave(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Take the constants of the constraints from the keypoints; training does not need them."""
        level = mean_level(parts, variables, keypoint_table(parts, variables, data))
        return {**variables, "dynamics": {**variables["dynamics"], "level": level}}
