"""Drawn pendulums, for tests without OpenGL, and random weights, which are faster than initial ones."""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from keycld_envs.mechanism import Mechanism, Rod
from keycld_envs.recordings import Dataset, Recording
from keycld_model.config import ModelConfig, NetworkConfig
from keycld_model.modules import Parameters, Parts

MECHANISM = Mechanism(num_keypoints=1, num_actions=1, rods=(Rod(None, 0),))
TIMESTEP = 0.02
SIZE = 16
NETWORKS = NetworkConfig(width=8, groups=4, constants=4, segment_widths=(0.1,), hidden=8)
CONFIG = ModelConfig(MECHANISM, TIMESTEP, (SIZE, SIZE), networks=NETWORKS)


def random_parameters(config: ModelConfig, seed: int = 0) -> Parameters:
    """Arrays of the right shapes, small enough for all outputs to be moderate; rods of 0.5 image units."""
    rng = np.random.default_rng(seed)
    parameters = jax.tree.map(lambda a: (0.2 * rng.normal(size=a.shape)).astype(np.float32), Parts(config).shapes())
    mechanism = config.mechanism
    level = [0.125] * len(mechanism.rods) + [0.0] * len(mechanism.sliders)
    parameters["dynamics"]["level"] = np.array(level, np.float32)
    parameters["dynamics"]["pivot"] = np.array(mechanism.pivot, np.float32)
    return parameters


def draw(angles: np.ndarray, size: int = SIZE) -> np.ndarray:
    """Frames [T, size, size, 3] uint8 of a bright bob 0.6 image units from the middle, clockwise from straight up."""
    axis = np.linspace(-1, 1, size)
    x, y = np.meshgrid(axis, -axis)
    bob = 0.6 * np.stack([np.sin(angles), np.cos(angles)], -1)[:, None, None]
    light = np.exp(-((x - bob[..., 0]) ** 2 + (y - bob[..., 1]) ** 2) / (2 * 0.15**2))
    return np.round(255 * (0.2 + 0.7 * light[..., None] * [1.0, 0.8, 0.5])).astype(np.uint8)


def swing(angle: float, action: float, frames: int) -> np.ndarray:
    """Angles [frames] of a pendulum that starts at rest."""
    angles, rate = [angle], 0.0
    for _ in range(frames - 1):
        for _ in range(20):
            rate += TIMESTEP / 20 * (20 * np.sin(angle) + 5 * action)
            angle += TIMESTEP / 20 * rate
        angles.append(angle)
    return np.array(angles)


def recordings(
    count: int = 8, length: int = 12, system: str | None = None, size: int = SIZE, **changes: Any
) -> list[Recording]:
    rng, clock = np.random.default_rng(0), TIMESTEP * np.arange(length)
    made = []
    for i in range(count):
        action = rng.uniform(-3, 3)
        angles = swing(rng.uniform(-np.pi, np.pi), action, length)
        fields: dict[str, Any] = {
            "id": f"run-{i:02d}",
            "system": system,
            "source": "simulation",
            "joint_names": ("hinge",),
            "actuator_names": ("torque",),
            "units": {"action": "N m", "qpos": "rad"},
            "t_action": clock[:-1],
            "action": np.full((length - 1, 1), action),
            "t_state": clock,
            "qpos": angles[:, None],
            "t_frame": clock,
            "frames": draw(angles, size),
        }
        made.append(Recording(**fields | changes))
    return made


def dataset(folder: str = "swinging", **options: Any) -> Dataset:
    return Dataset(Path(folder), tuple(recordings(**options)))
