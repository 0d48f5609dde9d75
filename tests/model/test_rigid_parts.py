"""Pictures of rigid parts, and keypoints that are put where these fit."""

from contextlib import closing
from typing import cast

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from keycld_envs import KeyCLDEnv, Mechanism, Rod, Slider
from keycld_model.config import ModelConfig, NetworkConfig
from keycld_model.modules import Parts
from keycld_model.nets import RigidParts, rigid_parts
from keycld_model.nets.rigid_parts import sine
from keycld_model.places import beside
from keycld_model.training.align import LEAST_SPREAD, REACHES, Align, _reach, _spread
from keycld_model.training.data import TrainingData
from keycld_model.training.sharding import Devices
from keycld_model.training.step import make_step

DOUBLE = Mechanism(2, 2, rods=(Rod(None, 0), Rod(0, 1)))
PIVOT = jnp.zeros(2)
FRAMES = 400


def test_a_part_for_every_rod_and_for_what_no_rod_holds():
    assert rigid_parts(DOUBLE) == ((None, 0), (0, 1))
    cart = Mechanism(2, 2, rods=(Rod(0, 1),), sliders=(Slider(0),))
    assert rigid_parts(cart) == ((0, None), (0, 1))


ARM = rigid_parts(DOUBLE)


def drawn(x, parts=ARM):
    module = RigidParts(parts, (32, 32), (12, 8), nnx.Rngs(0))
    return np.asarray(module(jnp.asarray([x], jnp.float32), PIVOT))[0]


def test_sines_are_sines():
    x = np.linspace(-20, 20, 10001)
    np.testing.assert_allclose(sine(jnp.asarray(x)), np.sin(x), atol=0.0012)
    slopes = jax.vmap(jax.grad(sine))(jnp.asarray(x))
    np.testing.assert_allclose(slopes, np.cos(x), atol=0.02)


def test_a_picture_turns_with_its_rods():
    up = drawn([(0.0, 0.4), (0.2, 0.7)])
    turned = drawn([(-0.4, 0.0), (-0.7, 0.2)])  # a quarter turn to the left
    assert up.std() > 0.01
    np.testing.assert_allclose(turned, np.rot90(up), atol=1e-5)
    assert np.abs(turned - up).max() > 0.05


def test_a_picture_that_no_rod_turns_moves_with_its_keypoint():
    cart = ((0, None),)
    pixel = 2.0 / 31
    here, there = drawn([(0.0, 0.0)], cart), drawn([(3 * pixel, -2 * pixel)], cart)
    np.testing.assert_allclose(there[6:, 6:], here[4:-2, 3:-3], atol=1e-4)


def test_what_is_far_from_all_parts_is_the_background():
    image = drawn([(0.0, 0.2), (0.0, 0.4)])
    assert image[-4:, :8].max() == 0.0
    assert image.max() > 0.01


def test_keypoints_at_one_place_are_drawn_all_the_same():
    assert np.isfinite(drawn([(0.0, 0.0), (0.0, 0.0)])).all()


@pytest.fixture(scope="module")
def filmed():
    """Frames `[1, FRAMES, 64, 64, 3]` of an acrobot in any pose, its keypoints there `[1, FRAMES, 4]`, image units."""
    frames, keypoints, rng = [], [], np.random.default_rng(0)
    with closing(cast(KeyCLDEnv, gym.make("KeyCLD/Acrobot-v0").unwrapped)) as env:
        for q in rng.uniform(-np.pi, np.pi, (FRAMES, 2)):
            env.reset(options={"qpos": q})
            frames.append(env.render_frame(width=64, height=64))
            keypoints.append(env.keypoints().ravel())
    return np.stack(frames)[None], np.array(keypoints, np.float32)[None]


@pytest.mark.slow
def test_shadows_and_reflections_are_no_parts(filmed):
    """They differ from the still scene, too: of what does, less than .98 lies within .3 image units of the links."""
    frames, true = filmed[0][0] / 255.0, filmed[1][0]
    parts = Parts(ModelConfig(DOUBLE, 0.01, networks=NetworkConfig(rigid_parts=True)))
    first = parts.initial(0)
    still = jnp.asarray(np.median(frames, axis=0), jnp.float32)
    variables = {**first, "appearance": {**first["appearance"], "background": still}}
    assert REACHES[0] <= _reach(parts, variables, frames.astype(np.float32), true) < 0.1


BESIDE = 0.02
"""Image units by which keypoints are beside their joints."""


def aligned_from_beside(frames, true):
    """Keypoints that began beside the joint, along the first rod, and variables before and after they were aligned."""
    parts = Parts(ModelConfig(DOUBLE, 0.01, networks=NetworkConfig(rigid_parts=True)))
    data = TrainingData(frames, np.zeros((1, FRAMES - 1, 2), np.float32), 0.01)
    upper, lower = true.reshape(1, FRAMES, 2, 2)[..., 0, :], true.reshape(1, FRAMES, 2, 2)[..., 1, :]
    along = BESIDE * upper / np.linalg.norm(upper, axis=-1, keepdims=True)  # both rods keep their lengths
    begun = np.concatenate([upper + along, lower + along], axis=-1)
    first, there = parts.initial(0), jnp.zeros(2)
    appearance = {**first["appearance"], "background": jnp.asarray(np.median(frames[0], 0) / 255.0)}
    variables = {**first, "appearance": appearance, "rod_scale": there, "lean": there}
    variables |= {"aligned": jnp.asarray(begun), "trust": jnp.ones((1, FRAMES)), "spread": jnp.full(2, 0.002)}
    return begun, variables, trained(Align(steps=400, batch=16, learning_rate=5e-3), parts, variables, data)


@pytest.mark.slow
def test_aligned_keypoints_lie_in_joints(filmed):
    frames, true = filmed
    begun, variables, learned = aligned_from_beside(frames, true)
    found = np.asarray(learned["aligned"])
    before, after = (np.linalg.norm((x - true)[..., :2], axis=-1).mean() for x in (begun, found))
    assert before == pytest.approx(BESIDE, rel=1e-3)
    assert after < 0.5 * before
    np.testing.assert_array_equal(learned["appearance"]["background"], variables["appearance"]["background"])


@pytest.mark.slow
def test_joints_are_learned_with_the_pictures(filmed, monkeypatch):
    frames, true = filmed
    monkeypatch.setattr(
        "keycld_model.training.align.align", lambda parts, variables, frames, positions, spread: positions
    )
    _, _, learned = aligned_from_beside(frames, true)
    assert np.linalg.norm(np.asarray(learned["aligned"]) - true, axis=-1).mean() < 0.2 * BESIDE


def test_a_share_of_the_frames_is_aligned_and_teaches(filmed):
    frames, true = filmed
    parts = Parts(ModelConfig(DOUBLE, 0.01, networks=NetworkConfig(rigid_parts=True)))
    data = TrainingData(frames, np.zeros((1, FRAMES - 1, 2), np.float32), 0.01)
    trust = np.ones((1, FRAMES), np.float32)
    trust[0, :100] = 0.0
    variables = {**parts.initial(0), "rod_scale": jnp.ones(2), "lean": jnp.ones(2)}
    variables |= {"aligned": jnp.asarray(true), "trust": jnp.asarray(trust), "spread": jnp.full(2, 0.002)}
    variables |= {"offsets": jnp.zeros((2, 2))}
    stage = Align(steps=0, batch=16, learning_rate=5e-3, share=0.1)
    found = stage.leave(parts, variables, data)
    assert np.flatnonzero(found["trust"]).tolist() == list(range(100, FRAMES, 10))
    moved = np.abs(found["aligned"] - true).max(-1)[0] > 0
    assert set(np.flatnonzero(moved)) <= set(range(100, FRAMES, 10))
    assert not np.any(found["rod_scale"]) and not np.any(found["lean"])


def test_a_keypoint_moves_with_the_part_that_holds_it_and_carries_others():
    cart = Mechanism(3, 1, rods=(Rod(0, 1), Rod(1, 2)), sliders=(Slider(0),))
    offsets = jnp.asarray([[0.1, 0.2], [0.3, 0.4], [9.0, 9.0]])  # at the last one, nothing is joined
    x = jnp.asarray([0.0, 0.0, 0.0, 2.0, 1.0, 2.0])  # the first rod stands, the second lies
    moved = beside(cart, PIVOT, offsets, x).reshape(3, 2)
    np.testing.assert_allclose(moved, [(0.1, 0.2), (0.1 - 0.4, 2.2 + 0.3), (1.1 - 0.4, 2.2 + 0.3)], atol=1e-6)


def test_trajectories_are_off_by_what_measured_keypoints_scatter_about_them():
    error = np.random.default_rng(0).normal(0.0, (0.01, 0.01, 0.0001, 0.0001), (20, 50, 4)) + 0.3
    error[0] = 5.0
    trust = np.ones((20, 50))
    trust[0] = 0.0
    np.testing.assert_allclose(_spread(error, trust), (0.01, LEAST_SPREAD), rtol=0.1)


def trained(stage, parts, variables, data):
    """Variables after a stage."""
    variables = stage.enter(parts, variables, data)
    context = stage.prepare(parts, variables, data)
    mine = {name: variables[name] for name in stage.trained}
    others = {name: value for name, value in variables.items() if name not in mine}
    optimiser = stage.optimiser()
    state, step = optimiser.init(mine), make_step(parts, stage, optimiser, Devices())
    for i in range(stage.steps):
        mine, state, _ = step(mine, others, state, stage.draw(context, data, np.random.default_rng(i)))
    return stage.leave(parts, {**others, **mine}, data)
