"""A keypoint that adds nothing to the others is moved to where images are not explained."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_model.modules import as_float
from keycld_model.training.data import TrainingData
from keycld_model.training.presets import PRESETS
from keycld_model.training.relocate import Rediscover, Relocate, spare_keypoint, unexplained

SIZE, FRAMES = 32, 120
AXIS = np.linspace(-1, 1, SIZE)
X, Y = np.meshgrid(AXIS, -AXIS)
CART_AND_POLE = Mechanism(2, 0, rods=(Rod(0, 1),), sliders=(Slider(0, (0, 1)),))


def blob(place: Any, width: float, numbers: Any = np) -> Any:
    """Images `[B, SIZE, SIZE]` of a spot."""
    return numbers.exp(-((X - place[:, None, None, 0]) ** 2 + (Y - place[:, None, None, 1]) ** 2) / (2 * width**2))


def centre(light: Array) -> Array:
    """Centres of bright light `[B, 2]` of images."""
    light = jnp.maximum(light - 0.3, 0.0)
    total = jnp.sum(light, axis=(1, 2)) + 1e-6
    return jnp.stack([jnp.sum(light * X, axis=(1, 2)) / total, jnp.sum(light * Y, axis=(1, 2)) / total], axis=1)


@dataclass(frozen=True, eq=False)
class Spots:
    """A red cart and a small green end of a pole, found and drawn by their colours.

    Attributes:
        follows: colours that keypoints are on.
    """

    follows: tuple[int, int]
    config: ClassVar[Any] = SimpleNamespace(mechanism=CART_AND_POLE)

    def keypoints(self, variables: Any, images: Array) -> Array:
        light = as_float(images)
        return jnp.concatenate([centre(light[..., c]) for c in self.follows], axis=1)

    def render(self, variables: Any, x: Array) -> Array:
        drawn = jnp.zeros((len(x), SIZE, SIZE, 3))
        for k, colour in enumerate(self.follows):
            spot = blob(x[:, 2 * k : 2 * k + 2], (0.2, 0.08)[colour], jnp)
            drawn = drawn.at[..., colour].set(jnp.maximum(drawn[..., colour], spot))
        return drawn

    def dynamics(self, variables: Any) -> Any:
        def constraint(x: Array) -> Array:
            return jnp.stack([0.5 * jnp.sum((x[2:] - x[:2]) ** 2), x[1]])

        return SimpleNamespace(constraint=constraint)


@pytest.fixture(scope="module")
def truth() -> tuple[np.ndarray, np.ndarray]:
    """Places of cart and end, `[FRAMES, 2]` each."""
    rng = np.random.default_rng(0)
    cart = np.stack([rng.uniform(-0.4, 0.4, FRAMES), np.zeros(FRAMES)], axis=1)
    angle = rng.uniform(-np.pi, np.pi, FRAMES)
    return cart, cart + 0.4 * np.stack([np.sin(angle), np.cos(angle)], axis=1)


@pytest.fixture
def data(truth: tuple[np.ndarray, np.ndarray]) -> TrainingData:
    cart, end = truth
    frames = np.stack([blob(cart, 0.2), blob(end, 0.08), np.zeros((FRAMES, SIZE, SIZE))], axis=-1)
    noisy = 255 * frames + np.random.default_rng(1).normal(0, 5, frames.shape)
    levels = np.clip(noisy, 0, 255).round().astype(np.uint8)
    return TrainingData(levels.reshape(12, 10, SIZE, SIZE, 3), np.zeros((12, 9, 0), np.float32), 0.02)


NOTHING: dict[str, Any] = {"estimator": {}, "renderer": {}, "dynamics": {}}
STAGE = Relocate(steps=1, batch=8, learning_rate=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("colour", [1, 0])
def test_two_keypoints_on_one_part_leave_one_for_the_other(colour, data, truth):
    """Of the two, the one whose rod and slider fit the other place: the end's on the cart, the cart's on the end."""
    parts: Any = Spots((0, 0) if colour else (1, 1))
    assert spare_keypoint(parts, NOTHING, data) == colour
    assert STAGE.needed(parts, NOTHING, data)
    there = unexplained(parts, NOTHING, data.flat_frames).place
    assert np.abs(there - truth[colour]).max() < 2 * 2 / SIZE
    inside = STAGE.enter(parts, NOTHING, data)
    places = np.asarray(inside["places"]).reshape(FRAMES, 2, 2)
    assert np.array_equal(places[:, colour], there)
    assert np.array_equal(places[:, 1 - colour], unexplained(parts, NOTHING, data.flat_frames).keypoints[:, :2])
    after = STAGE.leave(parts, inside, data)
    again = Rediscover(steps=1, batch=8, learning_rate=1e-3)
    assert again.needed(parts, after, data) and not again.needed(parts, NOTHING, data)
    assert again.leave(parts, after, data) == NOTHING


@pytest.mark.parametrize("name", ["default", "quick"])
def test_two_keypoints_may_be_moved_one_after_the_other(name):
    kinds = [type(stage) for stage in PRESETS[name].stages if isinstance(stage, Relocate | Rediscover)]
    assert kinds == [Relocate, Rediscover] * 2


def test_keypoints_that_explain_all_but_noise_stay(data):
    parts: Any = Spots((0, 1))
    assert spare_keypoint(parts, NOTHING, data) is None
    assert not STAGE.needed(parts, NOTHING, data)


def test_what_is_taught_is_the_distance_to_the_places(data):
    parts: Any = Spots((0, 0))
    context = STAGE.prepare(parts, STAGE.enter(parts, NOTHING, data), data)
    batch = STAGE.draw(context, data, np.random.default_rng(0))
    x = np.asarray(parts.keypoints(NOTHING, jnp.asarray(batch["frames"])))
    distance = np.linalg.norm((x - batch["places"]).reshape(-1, 2, 2), axis=-1).mean()
    assert STAGE.loss(parts, NOTHING, batch)[0] == pytest.approx(distance, abs=2e-3)


def test_a_place_that_its_rod_does_not_reach_is_not_taken(data, truth):
    """Light that wanders where it likes is on no part."""
    wandering = np.random.default_rng(2).uniform(-0.8, 0.8, (FRAMES, 2))
    frames = data.frames.copy()
    frames[..., 1] = (255 * blob(wandering, 0.08)).reshape(frames.shape[:-1])
    parts: Any = Spots((0, 0))
    assert spare_keypoint(parts, NOTHING, replace(data, frames=frames, memory={})) is None
