"""From world metres to image units.

Image units put the centres of the outermost pixels at -1 and 1: x to the right, y up, (0, 0) in the middle of the
image. OpenGL's normalised device coordinates put the image's *borders* at -1 and 1, and the centre of pixel column
j at (2j + 1)/W - 1, so that an image unit coordinate is the normalised device coordinate times W/(W - 1), for 64
pixels 64/63. In those units the pendulum of 0.5 m, 2.5 m before a camera of 45 degrees, is 0.4905 long and the links
of cartpole and acrobot (1 m at 6 m) 0.4088. Height and width are scaled separately; only square images keep lengths.
"""

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray


def pose(model: mujoco.MjModel, data: mujoco.MjData, qpos: ArrayLike) -> None:
    """Put bodies, cameras and lights where they are at joint positions `[nq]`, rad or m, to be drawn or projected."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)


def focal_length(model: mujoco.MjModel, camera: str, height: int) -> float:
    """Of a camera of the model, pixels of an image so high; infinite if it is orthographic."""
    found = model.camera(camera).id
    if model.cam_projection[found] == mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC:
        return float("inf")
    return float(height / 2 / np.tan(np.deg2rad(model.cam_fovy[found]) / 2))


def distance_of_links(model: mujoco.MjModel, data: mujoco.MjData, camera: str) -> float:
    """Of what moves from a camera of the model, on average and along its axis, m; one, if nothing moves.

    Args:
        model: the compiled model.
        data: its state; poses are read, so kinematics must be up to date.
        camera: name of the camera.
    """
    found, links = model.camera(camera).id, model.body_weldid[model.geom_bodyid] > 0
    if not links.any():
        return 1.0
    backward = data.cam_xmat[found].reshape(3, 3)[:, 2]
    return float(np.mean((data.cam_xpos[found] - data.geom_xpos[links]) @ backward))


def world_to_image(
    model: mujoco.MjModel, data: mujoco.MjData, points: ArrayLike, camera: str, width: int, height: int
) -> NDArray[np.float64]:
    """Project world points through a camera of the model.

    Args:
        model: the compiled model.
        data: its state; camera poses are read, so kinematics must be up to date (`mujoco.mj_forward`).
        points: [..., 3] world positions, metres.
        camera: name of a camera of the model, perspective or orthographic.
        width: W, image width in pixels, at least 2.
        height: H, image height in pixels, at least 2.

    Returns:
        [..., 2] positions in image units.
    """
    camera_id = model.camera(camera).id
    rotation = data.cam_xmat[camera_id].reshape(3, 3)
    x, y, z = np.moveaxis((np.asarray(points) - data.cam_xpos[camera_id]) @ rotation, -1, 0)
    if model.cam_projection[camera_id] == mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC:
        scale = 2 / model.cam_fovy[camera_id]  # the height of the image, in metres
    else:
        scale = 1 / np.tan(np.deg2rad(model.cam_fovy[camera_id]) / 2) / -z
    ndc_x, ndc_y = scale * height / width * x, scale * y
    return np.stack([ndc_x * width / (width - 1), ndc_y * height / (height - 1)], axis=-1)
