"""Cameras that see otherwise than the model says."""

import mujoco
import numpy as np
import pytest

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
        View(3.0, 2.0, 1.1, 0.9, 0.1),
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
    x, y = before
    x, y = x * np.cos(view.roll) - y * np.sin(view.roll), x * np.sin(view.roll) + y * np.cos(view.roll)
    x, y = x * view.zoom * view.aspect + view.right, y * view.zoom + view.up
    assert after == pytest.approx((x, y), abs=0.05)


def _centre(image):
    """Of what shines, pixels to the right and up from the middle."""
    weight = image.astype(float).sum(axis=2)
    rows, columns = np.mgrid[:SIZE, :SIZE]
    total = weight.sum()
    return (weight * columns).sum() / total - MIDDLE, MIDDLE - (weight * rows).sum() / total
