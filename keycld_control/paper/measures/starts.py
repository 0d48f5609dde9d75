"""What the way to find a state, and to step from it, is worth: the paper's beside ours."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_control.paper.measures.frames import beginning
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.evaluation import frame_errors, threshold, valid_frames
from keycld_model.world_model import CONTEXT_FRAMES

Floats = NDArray[np.floating]


def starts(model: WorldModel, test: Dataset, frames: int = 50) -> dict[str, float]:
    """Valid prediction times with less and less of what this library adds.

    Returns:
        "pixels": trajectories fitted to keypoints and pixels of five frames, as always; "keypoints": to keypoints
        alone; "difference": velocities from two frames, as the paper has them; "one_step": these, and one step per
        frame; "rest": positions from five frames and no velocity, which is what these recordings start with.
    """
    stacked = beginning(test, frames)
    epsilon, u = threshold(model, stacked.frames), jnp.asarray(stacked.actions)
    dynamics, h = model.parts.dynamics(model.parameters), model.timestep
    first, second = np.moveaxis(model.keypoints(stacked.frames[:, :2]).reshape(len(u), 2, -1), 1, 0)
    fitted, _ = model.rollout(stacked.frames[:, :CONTEXT_FRAMES], stacked.actions)
    shape = fitted.shape

    def moved(x: Floats, v: Floats, fine: bool = True) -> Floats:
        def one(x: Array, v: Array, u: Array) -> Array:
            return dynamics.rollout(*dynamics.project(x, v), u, h, fine)[0]

        return np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(x), jnp.asarray(v), u)).reshape(shape)

    speed, there = (second - first) / h, fitted[:, 0].reshape(len(u), -1)
    ways = {
        "pixels": fitted,
        "keypoints": model.rollout(stacked.frames[:, :CONTEXT_FRAMES], stacked.actions, refine=False)[0],
        "difference": moved(first, speed),
        "one_step": moved(first, speed, fine=False),
        "rest": moved(there, np.zeros_like(there)),
    }
    errors = {name: frame_errors(model, positions, stacked.frames) for name, positions in ways.items()}
    return {name: float(np.mean(valid_frames(error, epsilon)) / frames) for name, error in errors.items()}
