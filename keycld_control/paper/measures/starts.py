"""What the way to find a state, and to step from it, is worth: the paper's beside ours."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from keycld_control.paper.measures.frames import beginning
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.evaluation import frame_errors, prediction_errors, threshold, valid_frames


def starts(model: WorldModel, test: Dataset, frames: int = 50) -> dict[str, float]:
    """Valid prediction times with less and less of what this library adds.

    Returns:
        "pixels": trajectories fitted to keypoints and pixels of five frames, as always; "keypoints": to keypoints
        alone; "difference": velocities from two frames, as the paper has them; "one_step": these, and one step per
        frame.
    """
    stacked = beginning(test, frames)
    epsilon, u = threshold(model, stacked.frames), jnp.asarray(stacked.actions)
    dynamics, h = model.parts.dynamics(model.parameters), model.timestep
    first, second = np.moveaxis(model.keypoints(stacked.frames[:, :2]).reshape(len(u), 2, -1), 1, 0)

    def moved(fine: bool) -> Array:
        def one(x: Array, v: Array, u: Array) -> Array:
            return dynamics.rollout(*dynamics.project(x, v), u, h, fine)[0]

        return jax.jit(jax.vmap(one))(jnp.asarray(first), jnp.asarray((second - first) / h), u)

    shape = (*stacked.frames.shape[:2], model.mechanism.num_keypoints, 2)
    errors = {
        "pixels": prediction_errors(model, stacked.frames, stacked.actions),
        "keypoints": prediction_errors(model, stacked.frames, stacked.actions, refine=False),
        "difference": frame_errors(model, np.asarray(moved(True)).reshape(shape), stacked.frames),
        "one_step": frame_errors(model, np.asarray(moved(False)).reshape(shape), stacked.frames),
    }
    return {name: float(np.mean(valid_frames(error, epsilon)) / frames) for name, error in errors.items()}
