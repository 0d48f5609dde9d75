"""A link between two joints is two masses at its ends and one in its middle: it moves as MuJoCo's, and is found."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from keycld_control.benchmarks.intervals.keypoints import near_truth, simulate
from keycld_control.benchmarks.intervals.mechanisms import drawn_arm
from keycld_control.benchmarks.intervals.truth import truth_of
from keycld_control.plant import Plant, energy, responses
from keycld_envs import get_system
from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_model import WorldModel, physics
from keycld_model.config import PAPER_NETWORKS, ModelConfig, NetworkConfig
from keycld_model.learned_mjcf import learned_mjcf
from keycld_model.modules import Parts
from keycld_model.physics.masses import divided
from keycld_model.places import end_rods, inner_rods, slide_along_rods, sliding_rods
from keycld_model.training.covariance import measure_uncertainty
from keycld_model.training.identification import identify

pytestmark = pytest.mark.usefixtures("unoptimised")
CHAIN = Mechanism(4, 1, rods=(Rod(None, 0), Rod(0, 1), Rod(1, 2), Rod(2, 3)))
CART = Mechanism(3, 1, rods=(Rod(0, 1), Rod(1, 2)), sliders=(Slider(0),))
BEYOND = 0.04
"""Logarithm of a rod's length as seen, over its own."""
MASSES = jnp.asarray([0.2, 0.1, 0.15, 0.25, 0.1, 0.2])


def exact(seed, off=0.0):
    """What is true of a drawn arm of three links, and a model with its numbers or some near them."""
    truth = truth_of(drawn_arm(3, seed))
    parts, variables = near_truth(truth, np.random.default_rng(seed), off)
    return truth, parts, variables


def model_of(parts, variables):
    """With networks for images that draw nothing."""
    zeros = jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), parts.shapes())
    return WorldModel(parts.config, {**zeros, "dynamics": variables["dynamics"]})


def test_rods_between_two_joints():
    assert inner_rods(CHAIN) == [(0, 1), (1, 2)] and end_rods(CHAIN) == [(2, 3)]
    assert inner_rods(CART) == [(0, 1)] and sliding_rods(CART) == [(0, 1), (1, 2)]
    ring = replace(CHAIN, rods=(*CHAIN.rods, Rod(1, 3)))
    assert sliding_rods(ring) == [] and sliding_rods(CHAIN) == [(0, 1), (1, 2), (2, 3)]
    assert all(inner_rods(get_system(name).mechanism) == [] for name in ("pendulum", "cartpole", "acrobot"))


def test_a_rods_mass_moves_with_its_middle():
    v = jnp.asarray(np.random.default_rng(0).normal(size=8), jnp.float32)
    points = v.reshape(-1, 2)
    middles = jnp.stack([(points[0] + points[1]) / 2, (points[1] + points[2]) / 2])
    energy = 0.5 * jnp.sum(MASSES[:4, None] * points**2) + 0.5 * jnp.sum(MASSES[4:, None] * middles**2)
    assert physics.kinetic_energy(CHAIN, MASSES, v) == pytest.approx(float(energy), rel=1e-5)
    matrix, forces = physics.mass_matrix(CHAIN, MASSES), jnp.stack([v, 2 * v, v[::-1]])
    np.testing.assert_allclose(physics.momentum(CHAIN, MASSES, v), matrix @ v, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(divided(CHAIN, MASSES, forces) @ matrix, forces, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(physics.lumped(CHAIN, MASSES), [0.25, 0.25, 0.25, 0.25], rtol=1e-5)
    np.testing.assert_array_equal(physics.lumped(CHAIN, MASSES[:4]), MASSES[:4])


@pytest.mark.parametrize("seed", range(2))
def test_it_moves_as_mujocos_links_do(seed):
    """Keypoints of a simulated arm, and of the model with its masses, for half a second."""
    truth, parts, variables = exact(seed)
    assert truth.masses.shape == (4,) and (truth.masses > 0).all()
    motion = simulate(truth, 6, 26, np.random.default_rng(seed))
    x = truth.positions(motion.qpos).reshape(6, 26, -1).astype(np.float32)
    model = parts.lagrangian(variables)

    @jax.jit
    @jax.vmap
    def follow(x, u):
        def step(state, u):
            state = model.fine_step(state[0], state[1], u, parts.config.timestep)
            return state, state[0]

        return jax.lax.scan(step, (x, jnp.zeros_like(x)), u)[1]

    found = follow(jnp.asarray(x[:, 0]), jnp.asarray(motion.actions, jnp.float32))
    assert np.abs(np.asarray(found) - x[:, 1:]).max() < 0.003  # a tenth of a pixel of 64 x 64


def test_as_mjcf_it_moves_as_the_model_says():
    _, parts, variables = exact(0)
    world, lagrangian = model_of(parts, variables), parts.lagrangian(variables)
    document = learned_mjcf(world).model
    data, rng = mujoco.MjData(document), np.random.default_rng(0)
    assert document.body_mass.sum() == pytest.approx(1.0, abs=1e-5)
    step = jax.jit(lambda x, v, u: lagrangian.fine_step(x, v, u, world.timestep))
    jacobian, sites = np.zeros((3, 3, 3)), [document.site(f"keypoint_{k}").id for k in range(3)]
    for _ in range(3):
        mujoco.mj_resetData(document, data)
        data.qpos[:], data.qvel[:] = rng.uniform(-3, 3, 3), rng.normal(0, 1, 3)
        data.ctrl[:] = rng.uniform(-1, 1, 3)
        mujoco.mj_forward(document, data)
        for own, site in zip(jacobian, sites, strict=True):
            mujoco.mj_jacSite(document, data, own, None, site)
        v = jnp.asarray((jacobian @ data.qvel)[:, [0, 2]].ravel(), jnp.float32)
        x = jnp.asarray(data.site_xpos[sites][:, [0, 2]].ravel(), jnp.float32)
        energy = float(physics.kinetic_energy(world.mechanism, jnp.asarray(world.masses), v))
        mujoco.mj_energyVel(document, data)
        assert data.energy[1] == pytest.approx(energy, rel=1e-3)
        for _ in range(25):
            for _ in range(round(world.timestep / document.opt.timestep)):
                mujoco.mj_step(document, data)
            x, v = step(x, v, jnp.asarray(data.ctrl, jnp.float32))
        mujoco.mj_forward(document, data)
        assert np.abs(np.asarray(x) - data.site_xpos[sites][:, [0, 2]].ravel()).max() < 0.005


def test_agents_reckon_with_it():
    _, parts, variables = exact(0)
    world, lagrangian = model_of(parts, variables), parts.lagrangian(variables)
    plant, rng = Plant.of(world), np.random.default_rng(0)
    x, v = (jnp.asarray(part, jnp.float32) for part in rng.normal(scale=0.3, size=(2, 6)))
    x, v = lagrangian.project(x, v, 10)
    u = jnp.asarray([0.5, -1.0, 0.7])
    response, _ = responses(plant, x, v)
    expected = lagrangian.acceleration(x, v, u)
    size = float(jnp.abs(expected).max())
    np.testing.assert_allclose(response.free + response.inputs @ u, expected, atol=1e-4 * size)
    matrix = world.mass_matrix()
    np.testing.assert_allclose(response.gram, response.inputs.T @ matrix @ response.inputs, rtol=1e-4, atol=1e-4)
    kinetic = energy(plant, x, v) - plant.potential_energy(x)
    assert float(kinetic) == pytest.approx(float(v @ matrix @ v) / 2, rel=1e-4)


def test_checkpoints_from_before_have_none(tmp_path):
    config = ModelConfig(CHAIN, 0.02)
    assert Parts(config).shapes()["dynamics"]["log_masses"].shape == (6,)
    data = config.to_dict()
    del data["networks"]["rod_masses"]
    older = ModelConfig.from_dict(data)
    assert Parts(older).shapes()["dynamics"]["log_masses"].shape == (4,)
    for networks in (PAPER_NETWORKS, NetworkConfig(motion="unconstrained")):
        assert Parts(replace(config, networks=networks)).shapes()["dynamics"]["log_masses"].shape == (4,)


@pytest.mark.long
def test_identification_finds_it_beside_joints_and_says_how_far_it_may_be_off(tmp_path):
    """The second keypoint is seen 4 % of its rod beyond the joint, and so is what hangs on it."""
    truth, parts, near = exact(1, off=0.2)
    rng = np.random.default_rng(5)
    motion = simulate(truth, 20, 24, rng)
    x = truth.positions(motion.qpos).reshape(20, 24, -1)
    beyond = jnp.asarray([0.0, BEYOND, 0.0])
    at_keypoints = slide_along_rods(parts.config.mechanism, beyond, jnp.asarray(x, jnp.float32))
    seen = np.asarray(at_keypoints + 0.001 * rng.normal(size=x.shape), np.float32)
    actions = motion.actions.astype(np.float32)
    level = jax.vmap(parts.dynamics(near).constraint)(jnp.asarray(seen[:, 0])).mean(axis=0)
    start = x[:, 0].astype(np.float32)
    near = {
        **near,
        "dynamics": {**near["dynamics"], "level": level},
        "rod_scale": jnp.zeros(3),
        "lean": jnp.zeros(3),
        "trajectories": {"x": jnp.asarray(start), "v": jnp.zeros_like(start)},
    }
    found = identify(parts, near, seen, actions, iterations=10, sparse=True)
    masses = parts.lagrangian(found).masses
    assert found["rod_scale"][1] == pytest.approx(-BEYOND, abs=0.01)
    np.testing.assert_allclose(masses, truth.masses, atol=0.02)
    uncertainty = measure_uncertainty(parts, {k: found[k] for k in ("dynamics", "trajectories")}, seen, actions)
    model = replace(model_of(parts, found), uncertainty=uncertainty)
    model.save(tmp_path / "arm")
    again = WorldModel.load(tmp_path / "arm")
    np.testing.assert_array_equal(again.masses, model.masses)
    low, high = again.intervals().masses.T
    assert (low < high).all() and (low > -0.05).all() and (high - low < 0.2).all()
    assert (np.abs((low + high) / 2 - truth.masses) < 2 * (high - low)).all()
