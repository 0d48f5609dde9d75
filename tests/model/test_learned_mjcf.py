"""A learned Lagrangian as MJCF moves as the model says, and is seen where the model sees it."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from swinging import CONFIG, NETWORKS, random_parameters

from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_envs.rendering import Renderer
from keycld_model import WorldModel
from keycld_model.learned_mjcf import learned_mjcf

SYSTEMS = ("pendulum", "cartpole", "acrobot")


def sites(model, data):
    """Keypoints [2K] and their velocities, image units (per second)."""
    ids = [model.site(f"keypoint_{k}").id for k in range(model.nsite)]
    jacobians = np.zeros((model.nsite, 3, model.nv))
    for i, jacobian in zip(ids, jacobians, strict=True):
        mujoco.mj_jacSite(model, data, jacobian, None, i)
    return data.site_xpos[ids][:, [0, 2]].ravel(), (jacobians @ data.qvel)[:, [0, 2]].ravel()


def sprung():
    """The cartpole's model with a spring that holds the cart at a quarter of the image."""
    world = WorldModel.load("cartpole")
    dynamics = world.parameters["dynamics"]
    linear = dict(dynamics["potential"]["linear"])
    linear["kernel"] = linear["kernel"].at[0, 0].add(-0.25 * 3.0)
    potential = {**dynamics["potential"], "linear": linear}
    parameters = {**world.parameters, "dynamics": {**dynamics, "potential": potential, "spring": jnp.asarray([3.0])}}
    config = replace(world.config, networks=replace(world.config.networks, springs=True))
    return WorldModel(config, parameters)


@pytest.mark.parametrize("name", SYSTEMS)
def test_it_moves_as_the_model_says(name):
    world = WorldModel.load(name)
    model = mujoco.MjModel.from_xml_string(learned_mjcf(world).xml)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    lagrangian = world.parts.lagrangian(world.parameters)
    step = jax.jit(lambda x, v, u: lagrangian.fine_step(x, v, u, world.timestep))
    for _ in range(5):
        mujoco.mj_resetData(model, data)
        hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        data.qpos[:] = np.where(hinges, rng.uniform(-3, 3, model.nq), 0.0)
        data.qvel[:] = rng.normal(0, 1, model.nv)
        data.ctrl[:] = rng.uniform(-1, 1, model.nu)
        mujoco.mj_forward(model, data)
        x, v = (jnp.asarray(part, jnp.float32) for part in sites(model, data))
        for _ in range(50):
            for _ in range(round(world.timestep / model.opt.timestep)):
                mujoco.mj_step(model, data)
            mujoco.mj_forward(model, data)
            x, v = step(x, v, jnp.asarray(data.ctrl, jnp.float32))
            assert np.abs(np.asarray(x) - sites(model, data)[0]).max() < 0.03  # a pixel of 64 x 64


def test_a_spring_is_written_down():
    model = mujoco.MjModel.from_xml_string(learned_mjcf(sprung()).xml)
    assert model.jnt_stiffness == pytest.approx([30.0, 0.0]) and model.qpos_spring[0] == pytest.approx(0.25, abs=0.02)
    metres = mujoco.MjModel.from_xml_string(learned_mjcf(sprung(), of_system=True).xml)
    share = model.jnt_stiffness[0] / model.body_mass.sum()
    assert metres.jnt_stiffness[0] / metres.body_mass.sum() == pytest.approx(share, rel=1e-3)  # 1/s², in any units
    assert not mujoco.MjModel.from_xml_string(learned_mjcf(WorldModel.load("cartpole")).xml).jnt_stiffness.any()


def test_joints_and_motors_have_the_names_of_the_system():
    model = mujoco.MjModel.from_xml_string(learned_mjcf(WorldModel.load("acrobot")).xml)
    assert [model.joint(j).name for j in range(model.njnt)] == ["shoulder", "elbow"]
    assert [model.actuator(i).name for i in range(model.nu)] == ["shoulder", "elbow"]
    assert model.body_mass.sum() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.render
def test_the_camera_sees_keypoints_where_the_model_does():
    world = WorldModel.load("acrobot")
    model = mujoco.MjModel.from_xml_string(learned_mjcf(world).xml)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.7, -1.2
    mujoco.mj_forward(model, data)
    model.geom_rgba[:, 3], model.site_rgba[1] = 0.0, (1, 1, 1, 1)
    model.site_rgba[0, 3] = 0.0
    renderer = Renderer(model, 64, 64)
    light = renderer.render(data, "front").sum(axis=-1, dtype=float)
    renderer.close()
    light -= np.median(light)
    rows, columns = np.mgrid[:64, :64]
    seen = [(light * place).sum() / light.sum() for place in (columns, rows)]
    there = sites(model, data)[0][2:]
    assert seen == pytest.approx([31.5 + 31.5 * there[0], 31.5 - 31.5 * there[1]], abs=0.5)


def test_what_no_bodies_can_do_is_refused():
    ring = Mechanism(2, 1, rods=(Rod(None, 0), Rod(0, 1), Rod(None, 1)))
    for mechanism, sentence in (
        (ring, "held by 2"),
        (Mechanism(2, 1, rods=(Rod(0, 1),), sliders=(Slider(1),)), "Keypoint 0 is held by 0"),
    ):
        config = replace(CONFIG, mechanism=mechanism)
        with pytest.raises(InputError, match=sentence):
            learned_mjcf(WorldModel(config, random_parameters(config)))
    free = replace(CONFIG, networks=replace(NETWORKS, motion="unconstrained"))
    with pytest.raises(InputError, match="no rods and sliders"):
        learned_mjcf(WorldModel(free, random_parameters(free)))
    with pytest.raises(InputError, match="none of weights"):
        learned_mjcf(WorldModel(CONFIG, random_parameters(CONFIG)))


def test_from_the_command_line(tmp_path, capsys):
    out = tmp_path / "cartpole.xml"
    assert main(["export", "cartpole", "--to", "mjcf", "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["joints"] == ["slider", "hinge_1"] and 0 < found["left_out"]["inputs"] < 0.1
    assert mujoco.MjModel.from_xml_path(str(out)).nv == 2
    assert main(["export", "cartpole", "--to", "mjcf", "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["export", "nowhere", "--to", "mjcf", "--out", str(tmp_path / "more.xml")]) == 2
    assert "nowhere" in capsys.readouterr().err
