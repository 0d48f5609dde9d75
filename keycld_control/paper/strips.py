"""Figures 4, 5 and 13 to 15: frames of a recording above what a model predicts, and of a swing-up."""

from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray

from keycld_control.closed_loop import LoopSettings, make_loop, run_episode
from keycld_envs.files import atomic_file
from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.world_model import CONTEXT_FRAMES

EVERY, FRAMES = 4, 50
SHOWN = 13
"""Frames of a swing-up."""


def strip(model: WorldModel, test: Dataset, index: int = 0) -> NDArray[np.uint8]:
    """Image `[2H, nW, 3]`: frames of a recording, and below them those predicted from its first five."""
    stacked = test.sequences()
    frames, actions = stacked.frames[index, :FRAMES], stacked.actions[index, : FRAMES - 1]
    predicted = model.predict(frames[:CONTEXT_FRAMES], actions, len(frames)).frames
    drawn = np.round(255 * np.clip(np.nan_to_num(predicted), 0, 1)).astype(np.uint8)
    rows = [np.concatenate(list(row[::EVERY]), axis=1) for row in (frames, drawn)]
    return np.concatenate(rows)


def write_strip(path: Path, model: WorldModel, test: Dataset) -> None:
    """As a PNG file."""
    _write(path, strip(model, test))


def write_swing_up(path: Path, model: WorldModel, seed: int = 0) -> dict[str, Any]:
    """Figure 5: frames of one episode from hanging to where it stays upright, or of all of it, and the target.

    Args:
        path: PNG file.
        model: of a registered environment; loaded from where its name says.
        seed: of the episode.

    Returns:
        "success", and "upright_s", from when on it stayed, or None.
    """
    assert model.system is not None
    images: list[NDArray[np.uint8]] = []
    with make_loop(LoopSettings(model.system, model.name, start="hanging", seed=seed)) as loop:
        episode = run_episode(loop, seed, lambda image, _: images.append(image))
        target = loop.env.render_qpos(loop.env.system.target_qpos)
        end = min(episode.upright_s / loop.env.system.timestep, len(images) - 1)
    shown = [images[i] for i in np.linspace(0, end, SHOWN - 1).round().astype(int)]
    _write(path, np.concatenate([*shown, target], axis=1))
    return {"success": episode.success, "upright_s": episode.upright_s if episode.success else None}


def _write(path: Path, picture: NDArray[np.uint8]) -> None:
    encoded = iio.imwrite("<bytes>", picture, extension=".png")
    with atomic_file(path) as file:
        file.write(encoded)
