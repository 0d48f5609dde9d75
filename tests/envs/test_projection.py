"""Image units and true keypoints, against rendered pixels and against MuJoCo's own dynamics."""

import mujoco
import numpy as np
import pytest

from keycld_envs import SYSTEMS, KeyCLDEnv, get_system
from keycld_envs.projection import world_to_image


@pytest.mark.parametrize(("base", "lengths"), [("pendulum", [0.5]), ("cartpole", [1.0]), ("acrobot", [1.0, 1.0])])
@pytest.mark.parametrize("variant", ["", "-stock"])
@pytest.mark.parametrize("size", [32, 64])
def test_rods_have_their_true_length(base: str, variant: str, lengths: list[float], size: int) -> None:
    env = KeyCLDEnv(base + variant, obs_type="state", width=size, height=size)
    distance = {"pendulum": 2.5, "cartpole": 6.0, "acrobot": 6.0}[base]
    scale = size / (size - 1) / (distance * np.tan(np.pi / 8))
    mechanism = env.system.mechanism
    for seed in range(5):
        env.reset(seed=seed)
        points = env.keypoints()
        found = [
            np.linalg.norm(points[rod.end] - (points[rod.start] if rod.start is not None else mechanism.pivot))
            for rod in mechanism.rods
        ]
        np.testing.assert_allclose(found, scale * np.array(lengths), rtol=1e-9)
        for slider in mechanism.sliders:
            assert abs(points[slider.keypoint] @ slider.normal) < 1e-9


@pytest.mark.parametrize("name", ["pendulum", "acrobot"])
def test_upright_keypoints_are_above_the_pivot(name: str) -> None:
    env = KeyCLDEnv(name, obs_type="state")
    env.reset(options={"qpos": env.system.target_qpos})
    unit = {"pendulum": 0.4905, "acrobot": 0.4088}[name]
    expected = [[0, unit * (k + 1)] for k in range(env.system.mechanism.num_keypoints)]
    np.testing.assert_allclose(env.keypoints(), expected, atol=1e-4)
    env.reset(options={"qpos": env.system.hanging_qpos})
    np.testing.assert_allclose(env.keypoints(), -np.array(expected), atol=1e-4)
    quarter = np.zeros(env.model.nq)
    quarter[0] = np.pi / 2
    env.reset(options={"qpos": quarter})
    np.testing.assert_allclose(env.keypoints(), np.array(expected)[:, ::-1], atol=1e-4)


@pytest.mark.render
@pytest.mark.parametrize(("width", "height"), [(64, 64), (32, 32), (96, 64)])
def test_pixel_centres_span_minus_one_to_one(width: int, height: int) -> None:
    """The bob's centroid, over many images, lies where the projection says: slope 1 within 0.8 %, offset 0."""
    env = KeyCLDEnv("pendulum", width=width, height=height, render_quality="full")
    env.model.geom_rgba[:, 3] = 0  # leave only the bob: no rod, no floor
    env.model.geom_matid[:] = -1
    env.model.geom("mass").rgba[:] = 1
    xs, ys = np.linspace(-1, 1, width), np.linspace(1, -1, height)
    angles = np.linspace(-np.pi, np.pi, 40, endpoint=False)
    images = np.array([env.render_qpos([angle]) for angle in angles]).astype(float)
    weights = np.clip(np.abs(images - np.median(images, axis=0)).sum(-1) / 300, 0, 1)
    totals = weights.sum((1, 2))
    centroids = np.stack([(weights * xs).sum((1, 2)), (weights * ys[:, None]).sum((1, 2))], -1) / totals[:, None]
    expected = []
    for angle in angles:
        env.reset(options={"qpos": [angle]})
        expected.append(env.keypoints()[0])
    for axis in range(2):
        slope, offset = np.polyfit(np.array(expected)[:, axis], centroids[:, axis], 1)
        assert slope == pytest.approx(1, abs=0.008)  # 63/64 would be off by 0.016
        assert abs(offset) < 0.01
    env.close()


def test_projection_of_a_camera_that_looks_from_above() -> None:
    """dm_control's own pendulum camera looks down at 45 degrees; the centre of its image is on its axis."""
    env = KeyCLDEnv("pendulum-stock", obs_type="state")
    env.reset(seed=0)
    on_axis = np.array([0, -1.5, 2]) + 1.5 * np.array([0, 1, -1])
    points = world_to_image(env.model, env.data, [on_axis, on_axis + np.array([0.1, 0, 0])], "fixed", 64, 64)
    np.testing.assert_allclose(points[0], 0, atol=1e-9)
    assert points[1, 0] > 0.1 / 2.5 and abs(points[1, 1]) < 1e-9


@pytest.mark.parametrize(
    "name", [s.name for s in SYSTEMS.values() if all(mark.mass_position is not None for mark in s.landmarks)]
)
def test_point_masses_are_equivalent(name: str) -> None:
    """Some point masses at `mass_position` have exactly MuJoCo's mass matrix, up to rounding of the constants."""
    system, rng = get_system(name), np.random.default_rng(0)
    model = system.compile()
    data = mujoco.MjData(model)
    rows, targets = [], []
    for _ in range(10):
        data.qpos[:] = rng.uniform(-np.pi, np.pi, model.nq)
        mujoco.mj_forward(model, data)
        mass_matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass_matrix)
        products = []
        for landmark in system.landmarks:
            assert landmark.mass_position is not None
            body = model.body(landmark.body).id
            point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ landmark.mass_position
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, jacobian, None, point, body)
            products.append((jacobian.T @ jacobian).ravel())
        rows.append(np.transpose(products))
        targets.append(mass_matrix.ravel())
    rows, targets = np.concatenate(rows), np.concatenate(targets)
    masses, *_ = np.linalg.lstsq(rows, targets, rcond=None)
    np.testing.assert_allclose(rows @ masses, targets, atol=2e-5 * targets.max())
    assert (masses > 0).all()
    if name == "cartpole":
        assert masses[0] / masses[1] == pytest.approx(14.7, abs=0.01)
    if name == "acrobot":
        assert masses[0] / masses[1] == pytest.approx(0.957, abs=0.001)
