"""Gauss-Newton identification: it recovers a mechanism that is known, where gradient descent hardly moves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import random_parameters

from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_model.config import ModelConfig, NetworkConfig
from keycld_model.modules import Parts
from keycld_model.places import to_keypoints
from keycld_model.training.actuation import joint_forces
from keycld_model.training.identification import Fit, Problem, identify

pytestmark = pytest.mark.usefixtures("unoptimised")

PENDULUMS = Mechanism(num_keypoints=2, num_actions=2, rods=(Rod(None, 0), Rod(0, 1)))
CART = Mechanism(num_keypoints=2, num_actions=2, rods=(Rod(0, 1),), sliders=(Slider(0),))
N, T, TIMESTEP = 40, 24, 0.02
NOISE = 0.001
"""Image units."""
SCALE = 0.75
"""The mass is at this fraction of the distance at which its keypoint is seen."""


def truth(mechanism, masses, fan=False):
    """A model with gravity and motors, linear in the positions; its networks' nonlinear part is zero.

    The second motor is in the hinge between both parts, or a fan at the far end, across its rod.
    """
    parts = Parts(ModelConfig(mechanism, TIMESTEP, (16, 16), networks=NetworkConfig(width=8, constants=4, hidden=8)))
    variables = jax.tree.map(jnp.asarray, random_parameters(parts.config))
    dynamics = variables["dynamics"]
    dynamics["log_masses"] = jnp.log(jnp.asarray(masses))
    for name in ("potential", "input"):
        dynamics[name] = jax.tree.map(jnp.zeros_like, dynamics[name])
    gravity = jnp.asarray([0.0, 0.6 * masses[0], 0.0, 0.6 * masses[1]])[:, None]
    dynamics["potential"]["linear"]["kernel"] = gravity
    if "spring" in dynamics:
        dynamics["spring"] = jnp.zeros_like(dynamics["spring"])
    kernel, bias = np.zeros((4, 4, 2)), np.zeros((4, 2))  # position, force, action
    turn = 2.0 * np.array([[0.0, 1.0], [-1.0, 0.0]])  # force (-y, x) times the torque, up to the squared length
    kernel[:2, 2:, 1], kernel[2:, 2:, 1] = -turn, turn
    if not fan:
        kernel[:2, :2, 1], kernel[2:, :2, 1] = turn, -turn
    if mechanism is CART:
        bias[0, 0] = 1.0
    else:
        kernel[:2, :2, 0] = turn
        if not fan:
            kernel[:2, :2, 1] -= -turn  # what holds the motor, on the rod before it
    dynamics["input"]["linear"] = {
        "kernel": jnp.asarray(kernel.reshape(4, 4 * 2), jnp.float32),
        "bias": jnp.asarray(bias.ravel(), jnp.float32),
    }
    there = {"rod_scale": jnp.asarray([0.0, np.log(SCALE)], jnp.float32), "lean": jnp.zeros(2)}
    return parts, {**variables, **there}


def motion(parts, variables, noise):
    """Keypoints as they are seen, actions, and the true initial states."""
    rng, model = np.random.default_rng(0), parts.dynamics(variables)
    angles = rng.uniform(-np.pi, np.pi, (N, 2))
    arm = 0.5 * np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    first = arm[:, 0] if parts.config.mechanism is PENDULUMS else np.stack([angles[:, 0] / 8, np.zeros(N)], -1)
    x = jnp.asarray(np.concatenate([first, first + arm[:, 1]], axis=-1), jnp.float32)
    u = jnp.asarray(np.repeat(rng.uniform(-3, 3, (N, 1, 2)), T - 1, axis=1), jnp.float32)
    v = jnp.asarray(rng.normal(size=(N, 4)), jnp.float32)
    x, v = jax.vmap(model.project)(x, v)
    positions = jax.vmap(lambda x, v, u: model.rollout(x, v, u, TIMESTEP)[0])(x, v, u)
    seen = to_keypoints(parts.config.mechanism, variables, positions)
    return np.asarray(seen + noise * rng.normal(size=seen.shape), np.float32), np.asarray(u), {"x": x, "v": v}


@pytest.mark.long
@pytest.mark.parametrize(
    "mechanism, masses, guess",
    [(PENDULUMS, (0.6, 0.4), (0.5, 0.5)), (CART, (0.85, 0.15), (0.8, 0.2))],
    ids=["arm", "cart"],
)
def test_masses_and_their_places_are_found(mechanism, masses, guess):
    parts, right = truth(mechanism, masses)
    seen, actions, states = motion(parts, right, noise=NOISE)
    wrong = {**right, "rod_scale": jnp.zeros(2), "trajectories": states}
    wrong["dynamics"] = {**right["dynamics"], "log_masses": jnp.log(jnp.asarray(guess))}
    level = jax.vmap(parts.dynamics(right).constraint)(jnp.asarray(seen[:, 0]))
    wrong["dynamics"]["level"] = level.mean(axis=0)
    found = identify(parts, wrong, seen, actions, iterations=20)
    found = identify(parts, found, seen, actions, iterations=20, sparse=True)
    model = parts.lagrangian(found)
    assert float(jnp.exp(found["rod_scale"][1])) == pytest.approx(SCALE, rel=0.03)
    np.testing.assert_allclose(model.masses, masses, atol=0.02)
    assert float(jnp.sum(model.masses)) == pytest.approx(1, abs=1e-5)
    positions = jax.vmap(lambda x, v, u: model.rollout(x, v, u, TIMESTEP)[0])(
        found["trajectories"]["x"], found["trajectories"]["v"], actions
    )
    error = to_keypoints(mechanism, found, positions) - seen
    deviation = np.sort(np.sqrt(np.mean(error**2, axis=(1, 2))))
    assert deviation[-3] < 1.4 * NOISE  # two of forty recordings may get lost, from masses that wrong


@pytest.mark.long
def test_a_motor_that_does_not_act_on_a_keypoint_is_found_not_to():
    parts, right = truth(CART, (0.85, 0.15), fan=True)
    seen, actions, states = motion(parts, right, noise=NOISE)
    start = {**right, "trajectories": states}
    net = right["dynamics"]["input"]
    # the pole, sideways
    pushed = {
        **net,
        "linear": {**net["linear"], "bias": net["linear"]["bias"].at[2 * 2].set(0.2)},
    }
    start["dynamics"] = {**right["dynamics"], "input": pushed}
    found = identify(parts, start, seen, actions, iterations=10)
    found = identify(parts, found, seen, actions, iterations=25, sparse=True)["dynamics"]["input"]["linear"]
    force = np.abs(np.concatenate([found["kernel"].reshape(4, 4, 2), found["bias"].reshape(1, 4, 2)])).max(axis=0)
    assert force[2:, 0].max() < 0.002 < 0.1 < force[:2, 0].max()
    assert force[:, 1].max() > 0.1


@pytest.mark.parametrize("mechanism", [PENDULUMS, CART], ids=["arm", "cart"])
def test_forces_at_joints_do_the_same_work_everywhere(mechanism):
    linear, constant = joint_forces(mechanism, (0.1, 0.2))
    rng, works = np.random.default_rng(0), []
    for first, second in rng.uniform(-np.pi, np.pi, (5, 2)):
        turned = [0.4 * np.array([np.cos(a), -np.sin(a)]) for a in (first, second)]  # d/da of 0.4 (sin a, cos a)
        arm = [0.4 * np.array([np.sin(a), np.cos(a)]) for a in (first, second)]
        if mechanism is PENDULUMS:
            x = np.concatenate([(0.1, 0.2) + arm[0], (0.1, 0.2) + arm[0] + arm[1]])
            ways = [np.concatenate([turned[0], turned[0]]), np.concatenate([(0, 0), turned[1]])]
        else:
            x = np.concatenate([(first, 0.2), (first, 0.2) + arm[1]])
            ways = [np.concatenate([(0, 0), turned[1]]), np.array([1.0, 0, 1, 0])]
        works.append([[(x @ f + c) @ way for way in ways] for f, c in zip(linear, constant, strict=True)])
    square = -(0.4**2)  # counterclockwise, where angles are clockwise from above
    right = np.diag([square, square]) if mechanism is PENDULUMS else np.diag([square, 1.0])
    np.testing.assert_allclose(works, np.broadcast_to(right, np.shape(works)), atol=1e-12)


@pytest.mark.parametrize("fan", [False, True], ids=["hinge", "fan"])
def test_motors_act_at_joints_or_elsewhere(fan):
    parts, right = truth(CART, (0.85, 0.15), fan=fan)
    x, u = (
        jnp.asarray(np.random.default_rng(0).uniform(-0.5, 0.5, (4, 3, 4)), jnp.float32),
        np.zeros((4, 2, 2), np.float32),
    )
    problem = Problem(parts, right, x, u, slide=True, at_masses=True)
    assert problem.with_motors_at_joints(Fit(problem.start, x[:, 0], x[:, 1]))[1] != fan


@pytest.mark.long
def test_a_motor_at_a_hinge_is_told_from_the_mass_that_it_turns():
    """If forces may be anything, one on the cart that the hinge's motor does not have makes up for another mass."""
    parts, right = truth(CART, (0.85, 0.15))
    seen, actions, states = motion(parts, right, noise=3 * NOISE)
    wrong = {**right, "trajectories": states}
    pushed = right["dynamics"]["input"]["linear"]
    pushed = {**pushed, "kernel": pushed["kernel"].reshape(4, 4, 2).at[:2, 2:, 0].set(0.3 * np.eye(2)).reshape(4, 8)}
    wrong["dynamics"] = {
        **right["dynamics"],
        "log_masses": jnp.log(jnp.asarray((0.8, 0.2))),
        "input": {**right["dynamics"]["input"], "linear": pushed},
    }
    found = identify(parts, wrong, seen, actions, iterations=10, sparse=True)
    np.testing.assert_allclose(parts.lagrangian(found).masses, (0.85, 0.15), atol=0.003)
    kernel = np.asarray(found["dynamics"]["input"]["linear"]["kernel"]).reshape(4, 4, 2)
    np.testing.assert_allclose(kernel[:, :, 0], 0, atol=0.003)
    np.testing.assert_allclose(kernel[2:, 2:, 1] + kernel[:2, 2:, 1], 0, atol=1e-6)


@pytest.mark.long
def test_a_cart_whose_keypoint_leans_towards_its_pole():
    """The lean looks like mass of the pole; the motors tell them apart."""
    parts, right = truth(CART, (0.94, 0.06))
    seen, actions, states = motion(parts, {**right, "lean": jnp.asarray([-0.006, 0.0])}, noise=0.0004)
    start = {**right, "trajectories": states}
    found = identify(parts, start, seen, actions, iterations=10, sparse=True, acting=True)
    assert found["lean"][0] == pytest.approx(-0.006, abs=0.001)
    np.testing.assert_allclose(parts.lagrangian(found).masses, (0.94, 0.06), atol=0.001)
    upright = identify(parts, start, seen, actions, iterations=10)
    assert upright["lean"][0] == 0


@pytest.mark.long
def test_sequences_that_diverge_do_no_harm_and_masses_can_be_held_in_place():
    parts, right = truth(PENDULUMS, (0.6, 0.4))
    seen, actions, states = motion(parts, right, noise=NOISE)
    seen = seen.copy()
    seen[0] += 0.5 * np.random.default_rng(1).normal(size=seen[0].shape)
    start = {**right, "trajectories": {"x": states["x"], "v": states["v"].at[1].set(1e20)}}
    start["dynamics"] = {**right["dynamics"], "log_masses": jnp.zeros(2)}
    found = identify(parts, start, seen, actions, iterations=5, slide=False)
    np.testing.assert_array_equal(found["rod_scale"], right["rod_scale"])
    np.testing.assert_allclose(parts.lagrangian(found).masses, (0.6, 0.4), atol=0.02)


@pytest.mark.slow
def test_a_mechanism_without_motors():
    arm = Mechanism(num_keypoints=2, num_actions=0, rods=PENDULUMS.rods)
    config = ModelConfig(arm, TIMESTEP, (16, 16), networks=NetworkConfig(width=8, constants=4, hidden=8))
    parts, right = Parts(config), truth(PENDULUMS, (0.6, 0.4))[1]
    dynamics = {**right["dynamics"], "input": jax.tree.map(jnp.asarray, random_parameters(config))["dynamics"]["input"]}
    swinging = {**right, "dynamics": dynamics}
    rng, model = np.random.default_rng(0), parts.dynamics(swinging)
    x = jnp.asarray(rng.uniform(-0.4, 0.4, (4, 4)), jnp.float32)
    x, v = jax.vmap(model.project)(x, jnp.zeros_like(x))
    u = np.zeros((4, 7, 0), np.float32)
    seen = jax.vmap(lambda x, v, u: model.rollout(x, v, u, TIMESTEP)[0])(x, v, jnp.asarray(u))
    seen = to_keypoints(arm, swinging, seen)
    start = {**swinging, "trajectories": {"x": x, "v": v}}
    found = identify(parts, start, np.asarray(seen, np.float32), u, iterations=1, sparse=True)
    assert np.isfinite(found["dynamics"]["log_masses"]).all()
    np.testing.assert_allclose(parts.lagrangian(found).masses, (0.6, 0.4), atol=0.01)


@pytest.mark.long
def test_a_spring_along_the_rail():
    parts, right = truth(CART, (0.85, 0.15))
    stretched = {**right, "dynamics": {**right["dynamics"], "spring": jnp.asarray([2.0])}}
    seen, actions, states = motion(parts, stretched, noise=NOISE)
    found = identify(parts, {**right, "trajectories": states}, seen, actions, iterations=10, slide=False)
    model = parts.lagrangian(found)
    assert float(model.stiffness[0]) == pytest.approx(20.0, rel=0.02)
    np.testing.assert_allclose(model.masses, (0.85, 0.15), atol=0.02)
    without = truth(CART, (0.85, 0.15))[1]
    seen, actions, states = motion(parts, without, noise=NOISE)
    found = identify(parts, {**stretched, "trajectories": states}, seen, actions, iterations=10, slide=False)
    assert float(parts.lagrangian(found).stiffness[0]) == pytest.approx(0.0, abs=0.3)


@pytest.mark.slow
def test_if_all_diverge_nothing_changes():
    parts, right = truth(PENDULUMS, (0.6, 0.4))
    seen, actions, states = motion(parts, right, noise=0.0)
    start = {**right, "trajectories": {"x": states["x"], "v": jnp.full_like(states["v"], jnp.nan)}}
    found = identify(parts, start, seen, actions, iterations=2)
    np.testing.assert_allclose(found["dynamics"]["log_masses"], jnp.log(jnp.asarray((0.6, 0.4))), atol=1e-6)
    np.testing.assert_allclose(found["rod_scale"], right["rod_scale"], atol=1e-6)
