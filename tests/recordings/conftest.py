from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from keycld_envs.recordings import Recording


@pytest.fixture(scope="session")
def make_recording() -> Callable[..., Recording]:
    """A valid recording of a cartpole, 8 frames of 12×10 pixels, with any field replaced."""

    def make(seed: int = 0, num_frames: int = 8, **changes: Any) -> Recording:
        rng = np.random.default_rng(seed)
        clock = 0.01 * np.arange(num_frames)
        fields: dict[str, Any] = {
            "id": f"run-{seed:02d}",
            "system": "KeyCLD/Cartpole-v0",
            "source": "simulation",
            "joint_names": ("slider", "hinge"),
            "actuator_names": ("slide",),
            "units": {"action": "N", "qpos": ("m", "rad"), "qvel": ("m/s", "rad/s")},
            "camera": {"width": 12, "height": 10},
            "render_quality": "fast",
            "seed": seed,
            "licence": "CC0-1.0",
            "origin": "a test, für Ärger mit Kodierungen",
            "t_action": clock[:-1],
            "action": rng.normal(size=(num_frames - 1, 1)),
            "t_state": clock,
            "qpos": rng.normal(size=(num_frames, 2)),
            "qvel": rng.normal(size=(num_frames, 2)),
            "t_frame": clock,
            "frames": rng.integers(0, 256, (num_frames, 10, 12, 3), np.uint8),
        }
        return Recording(**fields | changes)

    return make
