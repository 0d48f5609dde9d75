"""The paper's ablations, each one field of a preset."""

from dataclasses import asdict, replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from flax import nnx
from gymnasium.spaces import Box
from swinging import CONFIG, SIZE, dataset, random_parameters

from keycld_control import EnergyShapingAgent
from keycld_envs import get_system
from keycld_envs.errors import InputError
from keycld_model import WorldModel
from keycld_model.acceleration_network import AccelerationNetwork
from keycld_model.config import ModelConfig, NetworkConfig
from keycld_model.lagrangian import Lagrangian
from keycld_model.modules import Parts
from keycld_model.training import PRESETS, Preset, train
from keycld_model.training.discover import Discover
from keycld_model.training.distil import Distil
from keycld_model.training.fit import FitTrajectories, FitWindows
from keycld_model.training.presets import with_networks
from keycld_model.training.stage import Stage, forgetful

pytestmark = pytest.mark.usefixtures("unoptimised")
ABLATIONS = {
    "nc": {"motion": "unconstrained"},
    "node2": {"motion": "acceleration"},
    "fc": {"images": "fully_connected"},
}
TINY = Preset(
    CONFIG.networks,
    (
        Discover(steps=2, batch=4, learning_rate=1e-3),
        FitWindows(steps=2, batch=4, learning_rate=1e-3, window=4, linear=True),
        FitTrajectories(steps=2, batch=4, learning_rate=1e-3, restart=True, identify=2),
        Distil(steps=2, batch=4, learning_rate=1e-3),
    ),
)

NOT_IDENTIFIED = replace(TINY, stages=(*TINY.stages[:2], replace(TINY.stages[2], identify=0), TINY.stages[3]))
"""With other networks for images, masses are identified as ever."""


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_says_what_it_is_and_builds(name):
    preset = PRESETS[name]
    assert preset.about and preset.steps > 0 and preset.length > 2
    assert Parts(ModelConfig(get_system("pendulum").mechanism, 0.02, networks=preset.networks)).shapes()


@pytest.mark.parametrize("name", ABLATIONS)
def test_an_ablation_is_one_field(name):
    default, preset = asdict(PRESETS["default"].networks), asdict(PRESETS[name].networks)
    assert {k: v for k, v in preset.items() if v != default[k]} == ABLATIONS[name]
    same = [type(s) for s in PRESETS[name].stages] == [type(s) for s in PRESETS["default"].stages]
    assert same and (name != "fc" or PRESETS[name].stages == PRESETS["default"].stages)


@pytest.mark.long
@pytest.mark.parametrize("name", ABLATIONS)
def test_an_ablation_trains_saves_and_predicts(name, tmp_path, monkeypatch):
    monkeypatch.setattr("keycld_model.training.loop.COLLAPSED", 0.0)
    monkeypatch.setattr("keycld_model.training.presets.DESCENT", 3)
    monkeypatch.setattr("keycld_model.training.loop._Run._score", lambda *_, **__: float("nan"))
    monkeypatch.setattr(Parts, "initial", lambda parts, seed: random_parameters(parts.config, seed))
    preset = with_networks(NOT_IDENTIFIED if name == "fc" else TINY, **ABLATIONS[name])
    size = 2 * SIZE if name == "fc" else SIZE  # fully connected networks halve an image more often
    config = replace(CONFIG, networks=preset.networks, image_shape=(size, size))
    train(dataset(size=size), config, tmp_path, preset)
    model = WorldModel.load(tmp_path)
    assert model.config == config
    run = dataset(size=size).recordings[0]
    keypoints, velocities = model.rollout(run.load_frames()[None, :3], np.zeros((1, 7, 1)), refine=False)
    assert keypoints.shape == velocities.shape == (1, 8, 1, 2)
    assert np.isfinite(keypoints).all() and np.isfinite(model.render(keypoints)).all()
    if name == "node2":
        for ask in (lambda: model.masses, lambda: model.potential_energy(keypoints)):
            with pytest.raises(InputError, match="network for the acceleration, so no masses"):
                ask()
    if name != "fc":
        with pytest.raises(InputError, match="rods and sliders hold its masses"):
            EnergyShapingAgent(model, run.load_frames()[0], action_space=Box(-3, 3, (1,)))


def test_without_constraints_each_keypoint_feels_only_its_own_force():
    mechanism = get_system("acrobot").mechanism
    dynamics = Lagrangian(mechanism, 8, 10.0, 0.5, False, nnx.Rngs(0), constrained=False)
    dynamics.log_masses[...] = jnp.array([0.0, 1.0])
    x, v = np.random.default_rng(0).normal(size=(2, 4)).astype(np.float32)
    u = jnp.ones(2)
    mass = np.repeat(np.asarray(dynamics.masses), 2)
    np.testing.assert_allclose(mass * dynamics.acceleration(x, v, u), dynamics.force(x, u), rtol=1e-5)
    np.testing.assert_array_equal(dynamics.project(x, v)[0], x)
    assert dynamics.tangent_space(x).shape == (4, 4)
    held = Lagrangian(mechanism, 8, 10.0, 0.5, False, nnx.Rngs(0))
    assert np.abs(held.acceleration(x, v, u) - dynamics.acceleration(x, v, u)).max() > 0.1


def test_node2_sees_position_velocity_and_action():
    network = AccelerationNetwork(get_system("acrobot").mechanism, 8, 1.0, 0.5, nnx.Rngs(0))
    x, v, u = jnp.ones(4), jnp.ones(4), jnp.ones(2)
    for argument in range(3):
        slope = jax.jacobian(network.acceleration, argument)(x, v, u)
        assert slope.shape == (4, (4, 4, 2)[argument]) and np.abs(slope).max() > 0


@pytest.mark.slow
def test_fully_connected_coordinates_do_not_move_with_the_image():
    """A fully convolutional estimator's do, by as much as the image, away from its edges."""
    shift = 8
    image = np.zeros((1, 64, 64, 3), np.float32)
    image[0, 28:34, 26:32] = 1.0
    shifted = np.roll(image, shift, axis=2)
    moved = {}
    for images in ("convolutional", "fully_connected"):
        networks = NetworkConfig(width=8, groups=1, saliency=0.0, segment_widths=(), images=images)
        parts = Parts(ModelConfig(get_system("pendulum").mechanism, 0.02, networks=networks))
        parameters = parts.initial(0)
        if images == "convolutional":  # sharp heatmaps
            parameters["estimator"]["hourglass"]["out"]["kernel"] *= 200
        found = [np.asarray(parts.keypoints(parameters, jnp.asarray(i)))[0] for i in (image, shifted)]
        moved[images] = found[1] - found[0]
    np.testing.assert_allclose(moved["convolutional"], [2 * shift / 63, 0], atol=0.01)
    assert np.abs(moved["fully_connected"] - [2 * shift / 63, 0]).max() > 0.05


def test_images_must_fit_the_halvings():
    networks = NetworkConfig(images="fully_connected")
    with pytest.raises(InputError, match="multiples of 32"):
        ModelConfig(get_system("pendulum").mechanism, 0.02, (48, 64), networks=networks)
    with pytest.raises(InputError, match="motion is 'free'"):
        NetworkConfig(motion="free")  # pyright: ignore[reportArgumentType]


def test_an_adam_that_forgets_is_sign_descent():
    """Adam's first step is the rate times the sign of the gradient, whatever its size; here every step is its first."""
    optimiser = forgetful(optax.adam(0.1))
    weights = jnp.array([1.0, -2.0])
    state = optimiser.init(weights)
    for gradient in ([3.0, -1e-3], [0.02, 5.0]):
        updates, new = optimiser.update(jnp.array(gradient), state, weights)
        np.testing.assert_allclose(np.asarray(updates), -0.1 * np.sign(gradient), rtol=1e-3)
        assert jax.tree.all(jax.tree.map(np.array_equal, new, state))
        state = new
    stages = [PRESETS[name].stages[0] for name in ("joint", "joint-sign")]
    assert replace(stages[0], forgetful=True) == stages[1]
    step = [_second_step(stage) for stage in stages]
    np.testing.assert_allclose(np.abs(step[1]), stages[1].learning_rate, rtol=1e-3)
    assert np.abs(step[0]) < 0.9 * stages[0].learning_rate  # gradients of both signs: the moments remember


def _second_step(stage: Stage) -> np.ndarray:
    optimiser, weight = stage.optimiser(), jnp.zeros(())
    state = optimiser.init(weight)
    for gradient in (1.0, -0.5):
        update, state = optimiser.update(jnp.asarray(gradient), state, weight)
    return np.asarray(update)
