"""Effects beside a Lagrangian of point masses move it as they move MuJoCo."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from oracle import SYSTEMS, make_oracle, point_masses, velocities

from keycld_control.plant import Plant, acceleration, advanced
from keycld_envs import InputError, get_system
from keycld_envs.effects import (
    AddedMass,
    CoulombFriction,
    ExternalPulse,
    GravityTilt,
    QuadraticDrag,
    Spring,
    ViscousFriction,
    edited,
)
from keycld_envs.effects.stored import effect_to_json, effects_from_json
from keycld_model import WorldModel
from keycld_model.added_effects import AddedEffects, added_effects, learned_power, power_of_joints
from keycld_model.physics import PointMasses


def added_to(name, effects, scale=1.0) -> tuple[AddedEffects, Plant]:
    exact = make_oracle(name, scale)
    points = PointMasses(exact.mechanism, exact.masses / exact.masses.sum() * scale, exact.level, exact.pivot)
    own = added_effects(
        effects, get_system(name), exact.timestep, points, exact.potential_energy_fn, exact.input_matrix_fn
    )
    learned = exact.potential_energy_fn
    plant = Plant.of(replace(exact, added=own, potential_energy_fn=lambda x: learned(x) + own.potential_energy(x)))
    return own, plant


def keypoint_acceleration(name, qpos, qvel, qacc):
    h = 1e-4
    after, before = (velocities(name, qpos + s * qvel, qvel + s * qacc) for s in (h, -h))
    return (after - before) / (2 * h)


@pytest.mark.parametrize("scale", [1.0, 7.0])
@pytest.mark.parametrize("name", SYSTEMS)
def test_forces_are_those_of_mujoco(name, scale):
    system = get_system(name)
    bare = system.compile()
    joints = [joint.name for joint in system.joints]
    smooth = [ViscousFriction(joints[-1], 0.2), QuadraticDrag(joints[0], 0.05), GravityTilt("world", 0.3)]
    spring = Spring(joints[-1], k=0.7, f=0.2)
    _, plant = added_to(name, [*smooth, spring], scale)
    model = edited(bare, smooth)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    act = jax.jit(lambda x, v, u: acceleration(plant, x, v, u))
    for _ in range(5):
        qpos, qvel = rng.uniform(-1, 1, model.nq), rng.uniform(-2, 2, model.nv)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, rng.uniform(-2, 2, model.nu)
        data.qfrc_applied[:] = spring.force(model, np.zeros(()), qpos, qvel, data.ctrl)
        mujoco.mj_forward(model, data)
        ours = act(*(jnp.asarray(a, jnp.float32) for a in _state(name, qpos, qvel)), jnp.asarray(data.ctrl))
        theirs = keypoint_acceleration(name, qpos, qvel, data.qacc)
        np.testing.assert_allclose(ours, theirs, atol=2e-3 * np.abs(theirs).max())


def _state(name, qpos, qvel):
    return point_masses(name, qpos), velocities(name, qpos, qvel)


@pytest.mark.parametrize("name", SYSTEMS)
def test_dry_friction_brakes_as_in_mujoco(name):
    system = get_system(name)
    model = system.compile()
    friction = [CoulombFriction(joint.name, 0.2) for joint in system.joints]
    _, plant = added_to(name, friction)
    step, h = jax.jit(lambda x, v: advanced(plant, x, v, jnp.zeros(model.nu))), system.timestep
    lossy = edited(model, friction)
    data = mujoco.MjData(lossy)
    data.qpos[:], data.qvel[:] = 0.4, 1.5
    x, v = (jnp.asarray(a, jnp.float32) for a in _state(name, data.qpos.copy(), data.qvel.copy()))
    for _ in range(round(0.1 / h)):
        mujoco.mj_step(lossy, data)
        x, v = step(x, v)
    np.testing.assert_allclose(x, point_masses(name, data.qpos), atol=4e-3)
    np.testing.assert_allclose(v, velocities(name, data.qpos.copy(), data.qvel.copy()), atol=0.05)


def test_an_effect_is_in_the_units_of_the_motor_at_its_joint():
    """Masses of a light link are learned less well than how its own motor moves it."""
    exact = make_oracle("cartpole")
    points = PointMasses(exact.mechanism, exact.masses, exact.level, exact.pivot)

    def stronger(x):
        return exact.input_matrix_fn(x) * jnp.array([1.0, 1.2])

    system = get_system("cartpole")
    whole = learned_power(system, points, stronger)
    slide, hinge = power_of_joints(system, points, stronger)
    assert hinge / slide == pytest.approx(1.2, rel=1e-3)
    assert slide < whole < hinge
    cloned = power_of_joints(system, points, exact.input_matrix_fn)
    np.testing.assert_allclose(cloned, learned_power(system, points, exact.input_matrix_fn), rtol=1e-3)


def test_dry_friction_holds_what_is_lighter_than_it():
    weight = float(np.abs(_bias("pendulum", [0.5])[0]))
    for share, moves in ((1.1, False), (0.8, True)):
        _, plant = added_to("pendulum", [CoulombFriction("hinge", share * weight)])
        x, v = (jnp.asarray(a, jnp.float32) for a in _state("pendulum", np.array([0.5]), np.zeros(1)))
        step = jax.jit(partial(advanced, plant))
        for _ in range(25):
            x, v = step(x, v, jnp.zeros(1))
        assert (np.abs(x - point_masses("pendulum", [0.5])).max() > 1e-3) == moves


def _bias(name, qpos):
    model = get_system(name).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data.qfrc_bias


def test_a_checkpoint_keeps_effects(tmp_path):
    effects = (CoulombFriction("hinge", 0.3), GravityTilt("world", 0.1))
    model = WorldModel.load("pendulum")
    assert model.effects == ()
    again = WorldModel.load(model.with_effects(effects).save(tmp_path / "corrected"))
    assert again.effects == effects
    np.testing.assert_array_equal(again.parameters["dynamics"]["level"], model.parameters["dynamics"]["level"])
    assert WorldModel.load(again.with_effects(()).save(tmp_path / "plain")).effects == ()


@pytest.mark.slow
def test_a_prediction_has_the_effects():
    model = WorldModel.load("pendulum")
    image = model.render(np.asarray(point_masses("pendulum", [1.0])).reshape(1, 2))
    frames, actions = np.repeat(image[None], 3, axis=0)[None], np.zeros((1, 40, 1), np.float32)
    moves = model.rollout(frames, actions)[0]
    held = model.with_effects([CoulombFriction("hinge", 6.0)]).rollout(frames, actions)[0]
    assert np.ptp(moves, axis=1).max() > 0.3
    assert np.ptp(held, axis=1).max() < 0.01


@pytest.mark.parametrize(
    "effect", [AddedMass("pole"), ExternalPulse("hinge"), CoulombFriction("elbow", 0.1), CoulombFriction("hinge", -1.0)]
)
def test_what_has_no_place_is_refused(effect):
    with pytest.raises(InputError):
        WorldModel.load("pendulum").with_effects([effect])


def test_effects_are_read_as_they_were_written():
    effects = (Spring("hinge", k=0.5, f=-0.1), GravityTilt("world", -0.2))
    assert effects_from_json([effect_to_json(effect) for effect in effects], "here") == effects


@pytest.mark.parametrize(
    "found",
    [
        {"effect": "magic", "where": {"kind": "joint", "name": "hinge"}, "parameters": {}},
        {"effect": "spring", "where": {"kind": "joint"}, "parameters": {}},
        {"effect": "spring", "where": {"kind": "joint", "name": "hinge"}, "parameters": {"z": {"value": 1}}},
        {"effect": "spring", "where": {"kind": "joint", "name": "hinge"}, "parameters": {"k": {"value": float("nan")}}},
        "spring",
    ],
)
def test_what_is_no_effect_is_refused(found):
    with pytest.raises(InputError):
        effects_from_json([found], "report.json: findings")
