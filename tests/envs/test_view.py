"""Cameras that see otherwise than the model says."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keycld_envs.projection import focal_length, pose
from keycld_envs.rendering import Renderer, View
from keycld_envs.systems import get_system

SIZE = 128
MIDDLE = (SIZE - 1) / 2


@pytest.mark.render
@pytest.mark.parametrize(
    "view",
    [
        View(right=3.0),
        View(up=2.0),
        View(zoom=1.1),
        View(aspect=1.1),
        View(roll=0.1),
        View(pitch=0.3),
        View(yaw=0.3),
        View(aside=0.3, distance=2.5),
        View(above=-0.3, nearer=0.2, distance=2.5),
        View(3.0, 2.0, 1.1, 0.9, 0.1),
        View(3.0, 2.0, 1.0, 0.9, 0.1, -0.1, 0.08),
        View(3.0, 2.0, 1.0, 0.9, 0.1, -0.1, 0.08, 0.1, -0.1, 0.1, 2.5),
    ],
)
def test_content_moves_as_the_view_says(view):
    system = get_system("pendulum")
    model = system.compile()
    model.geom_rgba[:], model.geom_matid[:] = 0, -1
    model.geom_rgba[model.geom("mass").id] = 1
    model.light_active[:], model.vis.headlight.ambient[:] = 0, 1  # as bright on every side
    model.vis.headlight.diffuse[:] = model.vis.headlight.specular[:] = 0
    data, focal, off = mujoco.MjData(model), focal_length(model, system.camera, SIZE), []
    renderer = Renderer(model, SIZE, SIZE, "fast")
    try:
        renderer._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0
        for angle in np.arange(0.1, 6.2, 0.5):
            data.qpos[:] = angle
            mujoco.mj_forward(model, data)
            before, after = (_centre(renderer.render(data, system.camera, v)) for v in (None, view))
            off.append(np.subtract(after, view.place(*before, focal)))
    finally:
        renderer.close()
    assert np.abs(np.mean(off, axis=0)).max() < 0.05
    assert np.abs(off).max() < 0.15  # a disc is drawn with four samples to a pixel


@pytest.mark.render
def test_a_view_is_what_a_camera_sees_that_stands_and_looks_elsewhere():
    system = get_system("cartpole")
    model = system.compile()
    moved, camera, data = copy.copy(model), model.camera(system.camera).id, mujoco.MjData(model)
    pose(model, data, [0.3, 0.5])
    focal, distance, (right, up, forward) = focal_length(model, system.camera, SIZE), 6.0, np.array([0.4, -0.3, 0.2])
    turn = Rotation.from_euler("YX", [-0.06, 0.08])  # to the right, then up
    axes = data.cam_xmat[camera].reshape(3, 3)
    moved.cam_pos[camera] += axes @ [right, up, -forward]
    moved.cam_quat[camera] = Rotation.from_matrix(axes @ turn.as_matrix()).as_quat(scalar_first=True)
    nearer = forward / distance
    view = View(0, 0, 1 / (1 - nearer), 1, 0, 0.08, 0.06, right / distance, up / distance, nearer, distance)
    ahead = turn.inv().apply([-right / distance, -up / distance, nearer - 1])  # what was in the middle
    seen = focal * ahead[:2] / -ahead[2]
    view = replace(view, right=seen[0], up=seen[1])
    assert np.abs(_image(moved, system.camera, None).astype(float) - _image(model, system.camera, view)).max() <= 1


def _image(model, camera, view):
    """Of a cart and a pole."""
    data, renderer = mujoco.MjData(model), Renderer(model, SIZE, SIZE, "fast")
    try:
        pose(model, data, [0.3, 0.5])
        return renderer.render(data, camera, view)
    finally:
        renderer.close()


def test_content_is_placed_as_pinhole_cameras_see_it():
    assert View(right=3.0, up=2.0, zoom=1.1, aspect=0.9).place(10.0, 20.0, 100.0) == pytest.approx((12.9, 24.0))
    assert View(roll=np.pi / 2).place(10.0, 20.0, 100.0) == pytest.approx((-20.0, 10.0))
    assert View(pitch=0.3).place(0.0, 0.0, 100.0) == pytest.approx((0.0, 0.0))
    angle = np.arctan(0.2)  # of a ray, upwards
    x, y = View(pitch=0.3).place(0.0, 20.0, 100.0)
    assert (x, y) == pytest.approx((0.0, 100 * (np.tan(angle - 0.3) + np.tan(0.3))))
    x, y = View(yaw=-0.3).place(20.0, 0.0, 100.0)
    assert (x, y) == pytest.approx((100 * (np.tan(angle + 0.3) - np.tan(0.3)), 0.0))
    assert View(pitch=0.3, yaw=0.2).place(10.0, 20.0, np.inf) == (10.0, 20.0)


def _centre(image):
    """Of what shines, pixels to the right and up from the middle."""
    weight = image.astype(float).sum(axis=2)
    rows, columns = np.mgrid[:SIZE, :SIZE]
    total = weight.sum()
    return (weight * columns).sum() / total - MIDDLE, MIDDLE - (weight * rows).sum() / total
