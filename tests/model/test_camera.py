"""A camera that differs by known amounts from the one that a background is of."""

import jax.numpy as jnp
import numpy as np
import pytest

from keycld_model.camera import FARTHEST, Camera, resampling, restore

SIZE = 64
ONES, ZEROS = np.ones(3), np.zeros(3)
GAIN, OFFSET = np.array([0.7, 0.8, 0.75]), np.array([0.02, 0.0, -0.01])


def scene(right=0.0, up=0.0, zoom=1.0):
    """[H, W, 3] of a smooth function of the place, as a camera sees it that is off."""
    row, column = np.mgrid[:SIZE, :SIZE].astype(float)
    centre = (SIZE - 1) / 2
    x, y = (column - centre - right) / zoom, (row - centre + up) / zoom
    waves = [np.sin(x / 4 + 0.3 * c) * np.cos(y / 5) + np.sin(x / 9 - y / 7 + c) for c in range(3)]
    return 0.45 + 0.12 * np.stack(waves, axis=-1)


def shown(right=0.0, up=0.0, zoom=1.0, gain=ONES, offset=ZEROS, noise=0.0, seed=0):
    """uint8 image of it, with a white bar before it."""
    image = scene(right, up, zoom)
    image[20:44, 30:34] = 1.0
    image = image * gain + offset + np.random.default_rng(seed).normal(0, noise / 255, image.shape)
    return np.clip(np.round(255 * image), 0, 255).astype(np.uint8)


BACKGROUND = scene().astype(np.float32)
DRAWN = (shown()[None] / 255).astype(np.float32)


def test_shift_zoom_and_light_are_found_beside_a_mechanism():
    found = Camera.find(BACKGROUND, shown(1.3, -2.6, 1.02, GAIN, OFFSET))
    assert found is not None
    assert (found.right, found.up) == pytest.approx((1.3, -2.6), abs=0.02)
    assert found.zoom == pytest.approx(1.02, abs=0.001)
    assert found.gain == pytest.approx(tuple(GAIN), abs=0.005)
    assert found.offset == pytest.approx(tuple(255 * OFFSET), abs=1)
    assert found.noise < 1


def test_noise_is_measured_and_hardly_disturbs():
    found = Camera.find(BACKGROUND, shown(2.0, 0.5, noise=10))
    assert found is not None
    assert found.noise == pytest.approx(10, rel=0.05)
    assert (found.right, found.up) == pytest.approx((2.0, 0.5), abs=0.15)


def test_restored_images_are_what_the_models_camera_would_have_shown():
    image = shown(2.3, 1.2, 0.98, GAIN, OFFSET)
    found = Camera.find(BACKGROUND, image)
    assert found is not None
    out = np.asarray(restore(found.restoration(DRAWN), jnp.asarray(BACKGROUND), jnp.asarray(image)))
    away = np.abs(np.arange(SIZE) - SIZE / 2) > 16
    assert np.abs(out - BACKGROUND)[:, away].max() < 0.02
    assert out[31, 29].min() > 0.9  # the bar, 2.3 pixels further left


def test_noise_is_taken_from_the_background_and_not_from_the_mechanism():
    image = shown(noise=10)
    found = Camera.find(BACKGROUND, image)
    assert found is not None
    out = np.asarray(restore(found.restoration(DRAWN), jnp.asarray(BACKGROUND), jnp.asarray(image)))
    away = np.abs(np.arange(SIZE) - SIZE / 2) > 16
    assert (out - BACKGROUND)[:, away].std() < 0.25 * 10 / 255
    assert out[30:34, 31:33].mean() > 0.95


def test_the_models_own_images_stay_as_they_are_bit_by_bit():
    assert Camera.find(BACKGROUND, shown()) == Camera()
    image = shown().astype(np.float32) / 255
    out = np.asarray(restore(Camera().restoration(DRAWN), jnp.asarray(BACKGROUND), jnp.asarray(image)))
    np.testing.assert_array_equal(out, image)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((SIZE, SIZE, 3), np.uint8),
        np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3)).astype(np.uint8),
        255 - shown(),
        shown(2.0 * FARTHEST),
    ],
    ids=["black", "noise", "inverted", "too far off"],
)
def test_what_does_not_show_the_background_is_told(image):
    assert Camera.find(BACKGROUND, image) is None


def test_resampling_is_exact_for_parabolas():
    """Cubic convolution reproduces polynomials of second degree (Keys 1981)."""
    where = (SIZE - 1) / 2 + 0.97 * (np.arange(SIZE) - (SIZE - 1) / 2) + 0.4
    moved = resampling(SIZE, 0.4, 0.97) @ np.arange(SIZE, dtype=float) ** 2
    np.testing.assert_allclose(moved[2:-2], where[2:-2] ** 2, rtol=1e-12)
    np.testing.assert_array_equal(resampling(SIZE, 0.0, 1.0), np.eye(SIZE))


def test_rows_beyond_the_image_are_empty():
    totals = resampling(SIZE, 2.0, 1.0).sum(axis=1)
    np.testing.assert_array_equal(totals, np.where(np.arange(SIZE) < SIZE - 2, 1.0, 0.0))


def test_what_is_cut_off_is_as_bright_as_the_mechanism():
    background = (
        np.full((SIZE, SIZE, 3), 0.4, np.float32) * (1 + 0.3 * np.sin(np.mgrid[:SIZE, :SIZE][0] / 4))[..., None]
    )
    drawn = background.astype(np.float32)
    drawn[20:30, 20:30] = 0.9
    image = np.clip(np.round(drawn * 1.3 * 255), 0, 255).astype(np.uint8)
    found = Camera.find(background.astype(np.float32), image)
    assert found is not None
    out = np.asarray(restore(found.restoration(drawn[None]), jnp.asarray(background, jnp.float32), jnp.asarray(image)))
    np.testing.assert_allclose(out[22:28, 22:28], 0.9, atol=0.01)  # 255 is 0.77
