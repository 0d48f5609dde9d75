"""Every row of the table of the paper's changes, in the compiled model."""

import mujoco
import numpy as np
import pytest

from keycld_envs import KeyCLDEnv, get_system

EULER, RK4 = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4
SELF, DECORATION, EFFECTOR = (0.7, 0.5, 0.3, 1), (0.3, 0.5, 0.7, 1), (0.7, 0.4, 0.2, 1)


LIMITS = {"pendulum": 3, "cartpole": 3, "acrobot": 15, "pendulum-stock": 1, "cartpole-stock": 1, "acrobot-stock": 1}


def compiled(name: str) -> mujoco.MjModel:
    return get_system(name).compile()


@pytest.mark.parametrize(
    ("base", "timestep", "integrator"), [("pendulum", 0.02, EULER), ("cartpole", 0.01, RK4), ("acrobot", 0.01, RK4)]
)
@pytest.mark.parametrize("variant", ["", "-stock"])
def test_time_step_and_integrator(base: str, variant: str, timestep: float, integrator: int) -> None:
    model = compiled(base + variant)
    assert model.opt.timestep == timestep == get_system(base + variant).timestep
    assert model.opt.integrator == integrator


@pytest.mark.parametrize(
    ("name", "camera", "position", "frontal"),
    [
        ("pendulum", "fixed", (0, -2.5, 0.6), True),
        ("pendulum-stock", "frontal", (0, -2.5, 0.6), True),
        ("pendulum-stock", "fixed", (0, -1.5, 2), False),
        ("cartpole", "fixed", (0, -6, 1), True),
        ("cartpole-stock", "frontal", (0, -6, 1), True),
        ("cartpole-stock", "fixed", (0, -4, 1), True),
        ("acrobot", "fixed", (0, -6, 2.1), True),
        ("acrobot-stock", "frontal", (0, -6, 2), True),
        ("acrobot-stock", "fixed", (0, -6, 2), True),
    ],
)
def test_cameras(name: str, camera: str, position: tuple[float, ...], frontal: bool) -> None:
    model = compiled(name)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.camera(camera).xpos, position)
    assert model.camera(camera).fovy == 45
    axes = data.camera(camera).xmat.reshape(3, 3)  # columns: right, up, backward
    looks_frontal = np.allclose(axes, np.transpose([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), atol=1e-12)
    assert looks_frontal == frontal


def test_damping(domain: str) -> None:
    stock = {"pendulum": [0.1], "cartpole": [5e-4, 2e-6], "acrobot": [0.05, 0.05]}[domain]
    np.testing.assert_array_equal(compiled(domain).dof_damping, np.zeros(len(stock)))
    np.testing.assert_array_equal(compiled(f"{domain}-stock").dof_damping, stock)


@pytest.mark.parametrize(
    ("name", "motors"),
    [
        ("pendulum", [("torque", "hinge", 2, 3)]),
        ("pendulum-stock", [("torque", "hinge", 1, 1)]),
        ("cartpole", [("slide", "slider", 4, 3), ("hinge_1", "hinge_1", 1, 3)]),
        ("cartpole-stock", [("slide", "slider", 10, 1)]),
        ("acrobot", [("shoulder", "shoulder", 2, 3), ("elbow", "elbow", 2, 3)]),
        ("acrobot-stock", [("elbow", "elbow", 2, 1)]),
    ],
)
def test_motors(name: str, motors: list[tuple[str, str, float, float]]) -> None:
    model = compiled(name)
    found = [
        (
            model.actuator(i).name,
            model.joint(model.actuator_trnid[i, 0]).name,
            model.actuator_gear[i, 0],
            model.actuator_ctrlrange[i].tolist(),
            bool(model.actuator_ctrllimited[i]),
        )
        for i in range(model.nu)
    ]
    assert found == [(name, joint, gear, [-limit, limit], True) for name, joint, gear, limit in motors]


def test_default_action_limits() -> None:
    found = {name: float(KeyCLDEnv(name, obs_type="state").action_space.high[0]) for name in LIMITS}
    assert found == LIMITS and get_system("acrobot").weak_limit == 3


@pytest.mark.parametrize(
    ("name", "geom", "radius", "rgba"),
    [
        ("pendulum", "pole", 0.02, SELF),
        ("pendulum", "mass", 0.05, EFFECTOR),
        ("pendulum-stock", "mass", 0.05, EFFECTOR),
        ("cartpole", "pole_1", 0.09, SELF),
        ("cartpole-stock", "pole_1", 0.045, SELF),
        ("cartpole", "cart", 0.2, DECORATION),
        ("cartpole-stock", "cart", 0.2, SELF),
        ("cartpole", "rail1", 0.02, DECORATION),
        ("acrobot", "upper_arm", 0.1, DECORATION),
        ("acrobot-stock", "upper_arm", 0.05, SELF),
        ("acrobot", "lower_arm", 0.099, SELF),
        ("acrobot-stock", "lower_arm", 0.049, SELF),
    ],
)
def test_radii_and_colours(name: str, geom: str, radius: float, rgba: tuple[float, ...]) -> None:
    model = compiled(name)
    assert model.geom(geom).size[0] == pytest.approx(radius)
    np.testing.assert_allclose(model.mat_rgba[model.geom(geom).matid[0]], rgba, atol=1e-6)


def test_cartpole_rail_and_floor() -> None:
    model, stock = compiled("cartpole"), compiled("cartpole-stock")
    for rail in ("rail1", "rail2"):
        assert (model.geom(rail).size[1], stock.geom(rail).size[1]) == (4, 2)
    assert (model.geom("floor").pos[2], stock.geom("floor").pos[2]) == (-0.2, -0.05)
    assert (bool(model.joint("slider").limited[0]), bool(stock.joint("slider").limited[0])) == (False, True)
    np.testing.assert_array_equal(stock.joint("slider").range, [-1.8, 1.8])


def test_acrobot_pivot_and_floor() -> None:
    model, stock = compiled("acrobot"), compiled("acrobot-stock")
    assert (model.body("upper_arm").pos[2], stock.body("upper_arm").pos[2]) == (2.1, 2)
    assert (model.geom("floor").size[0], stock.geom("floor").size[0]) == (6, 3)


def test_joint_order(name: str) -> None:
    model = compiled(name)
    assert [model.joint(i).name for i in range(model.njnt)] == [joint.name for joint in get_system(name).joints]
