"""Shapes, the grid, folding, the spatial softmax, and the paper's architecture."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from swinging import CONFIG, random_parameters

from keycld_envs import get_system
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism, Rod
from keycld_model.config import PAPER_NETWORKS, ModelConfig, NetworkConfig
from keycld_model.modules import Parts
from keycld_model.nets import MLP
from keycld_model.nets.estimator import KeypointEstimator
from keycld_model.nets.hourglass import double, fold, grid, halve, unfold

pytestmark = pytest.mark.usefixtures("unoptimised")
ACROBOT = get_system("acrobot").mechanism


def test_the_grid_has_pixel_centres_from_minus_one_to_one_and_y_up():
    cells = np.asarray(grid(5, 3, 1))
    assert cells.shape == (5, 3, 2)
    np.testing.assert_allclose(cells[0, 0], [-1, 1])
    np.testing.assert_allclose(cells[0, 2], [1, 1])
    np.testing.assert_allclose(cells[4, 0], [-1, -1])
    np.testing.assert_allclose(cells[2, 1], [0, 0], atol=1e-7)


def test_a_folded_cell_lies_at_the_mean_of_its_pixels():
    fine = np.asarray(grid(8, 12, 1))
    coarse = np.asarray(grid(8, 12, 2))
    np.testing.assert_allclose(coarse, fine.reshape(4, 2, 6, 2, 2).mean((1, 3)), atol=1e-6)


@pytest.mark.parametrize("factor", [1, 2, 4])
def test_unfold_inverts_fold(factor):
    x = np.random.default_rng(0).normal(size=(2, 8, 12, 3)).astype(np.float32)
    folded = fold(jnp.asarray(x), factor)
    assert folded.shape == (2, 8 // factor, 12 // factor, 3 * factor**2)
    np.testing.assert_array_equal(unfold(folded, factor), x)
    # The channels of a cell are the pixels that lie in it.
    np.testing.assert_array_equal(
        np.sort(folded[0, 1, 1]), np.sort(x[0, factor : 2 * factor, factor : 2 * factor], None)
    )


def test_halve_and_double():
    x = jnp.arange(16.0).reshape(1, 4, 4, 1)
    np.testing.assert_array_equal(halve(x)[0, ..., 0], [[5, 7], [13, 15]])
    np.testing.assert_array_equal(double(halve(x))[0, :2, :, 0], [[5, 5, 7, 7], [5, 5, 7, 7]])


@pytest.mark.parametrize("factor", [1, 2])
def test_the_spatial_softmax_picks_a_pixel(factor):
    estimator = nnx.eval_shape(lambda: KeypointEstimator(2, (16, 16), 8, 4, factor, 0.0, nnx.Rngs(0)))
    size = 16 // factor
    logits = np.zeros((1, size, size, 2), np.float32)
    logits[0, 1, 2, 0] = logits[0, size - 1, 0, 1] = 100
    object.__setattr__(estimator, "heatmaps", lambda images: jnp.asarray(logits))
    found = estimator(jnp.zeros((1, 16, 16, 3)))
    cells = np.asarray(grid(16, 16, factor))
    np.testing.assert_allclose(found[0], [cells[1, 2], cells[size - 1, 0]], atol=1e-5)
    assert found[0, 0, 1] > 0 > found[0, 1, 1]  # the first is above the middle


@pytest.mark.slow
def test_saliency_attends_to_what_differs_from_the_mean_frame():
    parts = Parts(replace(CONFIG, networks=replace(CONFIG.networks, saliency=30.0)))
    parameters = random_parameters(parts.config)
    parameters["estimator"]["background"][:] = 0.5
    parameters["estimator"]["hourglass"]["out"]["kernel"][:] = 0
    cells = np.asarray(grid(16, 16, CONFIG.networks.folding))
    for row, column in ((5, 8), (10, 7)):
        image = np.full((1, 16, 16, 3), 0.5, np.float32)
        image[0, row, column] = 1.0
        found = parts.keypoints(parameters, jnp.asarray(image))[0]
        np.testing.assert_allclose(found, cells[row // 2, column // 2], atol=0.1)


@pytest.mark.parametrize("networks", [NetworkConfig(), PAPER_NETWORKS], ids=["default", "paper"])
def test_shapes_and_ranges(networks):
    config = ModelConfig(ACROBOT, 0.01, (24, 16), networks=networks)
    parts, parameters = Parts(config), random_parameters(config)
    images = np.random.default_rng(0).integers(0, 256, (3, 24, 16, 3), np.uint8)
    keypoints = jax.jit(parts.keypoints)(parameters, images)
    assert keypoints.shape == (3, 4)
    assert np.abs(keypoints).max() <= 1
    frames = jax.jit(parts.render)(parameters, keypoints)
    assert frames.shape == (3, 24, 16, 3)
    assert np.min(frames) >= 0 and np.max(frames) <= 1
    as_float = jax.jit(parts.keypoints)(parameters, images / np.float32(255))
    np.testing.assert_allclose(as_float, keypoints, atol=1e-4)


def test_initial_parameters_have_the_declared_shapes_and_depend_on_the_seed():
    parts = Parts(CONFIG)
    first, second = parts.initial(0), parts.initial(1)
    assert jax.tree.map(lambda a: (a.shape, a.dtype), first) == jax.tree.map(
        lambda a: (a.shape, a.dtype), parts.shapes()
    )
    assert not np.array_equal(first["renderer"]["constant"], second["renderer"]["constant"])
    np.testing.assert_array_equal(first["renderer"]["constant"], parts.initial(0)["renderer"]["constant"])


def test_maps_peak_at_the_keypoints_and_along_the_rods():
    mechanism = Mechanism(2, 1, rods=(Rod(None, 0), Rod(0, 1)))
    config = ModelConfig(
        mechanism, 0.01, (32, 32), networks=NetworkConfig(gaussian_widths=(0.1,), segment_widths=(0.1,))
    )
    renderer = Parts(config)._module("renderer", random_parameters(config))
    cells = np.asarray(grid(32, 32, 1))
    keypoints = cells[[4, 20], [9, 25]]
    maps = np.asarray(renderer.maps(jnp.asarray(keypoints)[None], jnp.zeros(2)))[0]
    assert maps.shape == (32, 32, 4)
    for k, pixel in enumerate([(4, 9), (20, 25)]):
        assert np.unravel_index(maps[..., k].argmax(), (32, 32)) == pixel
        np.testing.assert_allclose(maps[..., k], np.exp(-((cells - keypoints[k]) ** 2).sum(-1) / 0.02), atol=1e-5)
    # Equation 9 at one standard deviation; the distance to a rod is that to its nearest point.
    for column, (a, b) in enumerate([(np.zeros(2), keypoints[0]), (keypoints[0], keypoints[1])], start=2):
        points = a + np.linspace(0, 1, 2001)[:, None] * (b - a)
        squared = ((cells[:, :, None] - points) ** 2).sum(-1).min(-1)
        np.testing.assert_allclose(maps[..., column], np.exp(-squared / 0.02), atol=1e-3)


def test_the_pivot_moves_the_first_rod():
    config = ModelConfig(ACROBOT, 0.01, (32, 32))
    renderer = Parts(config)._module("renderer", random_parameters(config))
    x = jnp.array([[[0.5, 0.5], [0.5, -0.5]]])
    first, second = (np.asarray(renderer.maps(x, jnp.array(p)))[0] for p in ([0.0, 0.0], [0.0, 0.5]))
    changed = np.abs(first - second).max((0, 1)) > 0.1
    gaussians = 2 * len(config.networks.gaussian_widths)
    per_rod = len(config.networks.segment_widths)
    assert changed.tolist() == [False] * gaussians + [True] * per_rod + [False] * per_rod


def count(tree):
    return sum(leaf.size for leaf in jax.tree.leaves(tree))


def test_the_papers_architecture():
    """Appendix A.4: the hourglasses with 32, 64, 128 channels; 0.60 M parameters for two keypoints."""
    parameters = Parts(ModelConfig(ACROBOT, 0.01, (64, 64), networks=PAPER_NETWORKS)).shapes()
    assert count([parameters["estimator"], parameters["renderer"]]) == pytest.approx(0.60e6, abs=0.005e6)
    for name, inputs, outputs in (("estimator", 3, 2), ("renderer", 32, 3)):
        hourglass = parameters[name]["hourglass"]
        kernels = {layer: part["conv"]["kernel"].shape for layer, part in hourglass.items() if "conv" in part}
        assert kernels == {
            "fine": (3, 3, inputs, 32),
            "middle": (3, 3, 32, 64),
            "coarse": (3, 3, 64, 128),
            "middle_up": (3, 3, 192, 64),
            "fine_up": (3, 3, 96, 32),
        }
        assert hourglass["out"]["kernel"].shape == (3, 3, 32, outputs)
    assert parameters["renderer"]["constant"].shape == (64, 64, 30)
    assert set(parameters["renderer"]) == {"constant", "hourglass"}
    assert set(parameters["estimator"]) == {"hourglass"}
    for head, outputs in (("potential", 1), ("input", 8)):
        shapes = [parameters["dynamics"][head][layer]["kernel"].shape for layer in ("first", "second", "out")]
        assert shapes == [(4, 32), (32, 32), (32, outputs)]


def test_the_papers_initial_forces_are_small():
    mlp = MLP(4, 32, 1, PAPER_NETWORKS.force_scale, PAPER_NETWORKS.kernel_scale, False, nnx.Rngs(0))
    for layer in (mlp.first, mlp.second, mlp.out):
        assert np.std(layer.kernel[...]) == pytest.approx(0.01, rel=0.3)
    x = jnp.linspace(-1, 1, 4)
    np.testing.assert_allclose(mlp(x), mlp.out(nnx.celu(mlp.second(nnx.celu(mlp.first(x))))))


@pytest.mark.parametrize(
    "change", [{"image_shape": (60, 64)}, {"image_shape": (0, 64)}, {"timestep": 0.0}, {"timestep": float("nan")}]
)
def test_configurations_that_cannot_be(change):
    with pytest.raises(InputError):
        ModelConfig(**{"mechanism": ACROBOT, "timestep": 0.01, **change})


def test_a_configuration_survives_json():
    mechanism = Mechanism(2, 1, rods=(Rod(None, 0), Rod(0, 1)), pivot=(0.1, -0.2))
    config = ModelConfig(mechanism, 0.01, (64, 32), "KeyCLD/Acrobot-v0", PAPER_NETWORKS)
    data = json.loads(json.dumps(config.to_dict()))
    assert ModelConfig.from_dict(data) == config
    for damage in ({"networks": {}}, {"mechanism": {}}, {"image_shape": [64]}, {"timestep": "x"}):
        with pytest.raises(InputError):
            ModelConfig.from_dict(data | damage)
    with pytest.raises(InputError, match="colour"):
        ModelConfig.from_dict(data | {"networks": data["networks"] | {"colour": 3}})
