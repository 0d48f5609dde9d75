"""Films of swinging mechanisms with a camera that is not quite the simulator's."""

import copy
import io
from collections.abc import Callable, Sequence

import imageio.v3 as iio
import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from keycld_envs.recordings import Recording
from keycld_envs.rendering import Renderer, View
from keycld_envs.systems import get_system

DT = 0.02


def film(
    system: str,
    runs: int = 2,
    frames: int = 30,
    view: View | None = None,
    develop: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] = lambda image: image,
    change: Callable[[mujoco.MjModel], None] = lambda model: None,
    size: tuple[int, int] = (64, 64),
    seed: int = 0,
    qvel: Sequence[float] = (),
) -> tuple[list[Recording], list[NDArray[np.float64]]]:
    """Recordings with frames alone, released from rest or at speeds, and the true positions."""
    declared, rng = get_system(system), np.random.default_rng(seed)
    model = declared.compile()
    change(model)
    data, renderer = mujoco.MjData(model), Renderer(copy.copy(model), size[1], size[0], "fast")
    recordings, truth = [], []
    for run in range(runs):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = [rng.uniform(*joint.start_range) for joint in declared.joints]
        data.qvel[:] = qvel or 0.0
        images, positions = [], []
        for _ in range(frames):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            images.append(develop(renderer.render(data, declared.camera, view)))
            positions.append(data.qpos.copy())
            for _ in range(round(DT / model.opt.timestep)):
                mujoco.mj_step(model, data)
        truth.append(np.array(positions))
        recordings.append(
            Recording(
                id=f"{run}",
                source="simulation",
                t_frame=np.arange(frames, dtype=np.float64) * DT,
                frames=np.stack(images),
                camera={"name": declared.camera, "width": size[1], "height": size[0]},
                render_quality="fast",
            )
        )
    renderer.close()
    return recordings, truth


def jpeg(image: np.ndarray, quality: int = 95, **options: str) -> np.ndarray:
    """After compression."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality, **options)
    return np.asarray(iio.imread(file.getvalue(), extension=".jpg"))
