"""Cameras that see otherwise than the model says."""

import mujoco
import numpy as np
import pytest

from keycld_envs.projection import focal_length
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
        View(3.0, 2.0, 1.1, 0.9, 0.1),
        View(3.0, 2.0, 1.0, 0.9, 0.1, -0.1, 0.08),
    ],
)
def test_content_moves_as_the_view_says(view):
    system = get_system("pendulum")
    model = system.compile()
    model.geom_rgba[:], model.geom_matid[:] = 0, -1
    model.geom_rgba[model.geom("mass").id] = 1
    data = mujoco.MjData(model)
    data.qpos[:] = 0.7
    mujoco.mj_forward(model, data)
    renderer = Renderer(model, SIZE, SIZE, "fast")
    try:
        renderer._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0
        before, after = (_centre(renderer.render(data, system.camera, v)) for v in (None, view))
    finally:
        renderer.close()
    focal = focal_length(model, system.camera, SIZE)
    assert after == pytest.approx(view.place(*before, focal), abs=0.05)


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
