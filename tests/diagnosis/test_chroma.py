"""Films whose chroma was halved are compared by luma, and drawings with chroma halved likewise."""

import numpy as np
import pytest
from films import jpeg
from PIL import Image

from keycld_envs.systems import get_system
from keycld_model.image_alignment.chroma import HalvedChroma
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import align
from keycld_model.image_alignment.scene import Scene


def coloured(size: tuple[int, int], seed: int = 0) -> np.ndarray:
    """An image of coloured blocks with noise."""
    rng = np.random.default_rng(seed)
    blocks = rng.uniform(40, 215, (-(-size[0] // 5), -(-size[1] // 5), 3))
    image = np.repeat(np.repeat(blocks, 5, axis=0), 5, axis=1)[: size[0], : size[1]]
    return np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("size", [(64, 64), (61, 80)])
def test_halved_chroma_is_told_from_whole(size):
    film = np.stack([coloured(size, seed) for seed in range(3)])
    assert HalvedChroma.of([film]) is None
    assert HalvedChroma.of([np.stack([jpeg(f, subsampling="4:4:4") for f in film])]) is None
    halved = HalvedChroma.of([np.stack([jpeg(f) for f in film])])
    assert halved is not None
    assert halved.upsampling == "linear"


def test_a_decoder_that_repeats_chroma_is_told_as_well():
    film = np.stack([coloured((64, 64), seed) for seed in range(3)])
    whole = np.stack([np.asarray(Image.fromarray(f).convert("YCbCr")) for f in film])
    whole[..., 1:] = np.repeat(np.repeat(whole[:, ::2, ::2, 1:], 2, axis=1), 2, axis=2)
    repeated = np.stack([np.asarray(Image.frombytes("YCbCr", (64, 64), f.tobytes()).convert("RGB")) for f in whole])
    halved = HalvedChroma.of([repeated])
    assert halved is not None
    assert halved.upsampling == "nearest"


@pytest.mark.parametrize("size", [(64, 64), (61, 80)])
def test_a_drawing_becomes_what_compression_makes_of_it(size):
    image = coloured(size)
    shown = jpeg(image, 100, subsampling="4:2:0")
    halved = HalvedChroma.of([shown[None]])
    assert halved is not None
    there, drawn = halved.filmed(shown[None])[0].astype(float), halved.drawn(image.astype(np.float32))
    whole = halved.filmed(image[None])[0].astype(float)
    assert np.abs(there - drawn)[..., 0].mean() < 1.0  # luma stays
    assert np.sqrt(np.mean((there - drawn)[..., 1:] ** 2)) < 0.3 * np.sqrt(np.mean((there - whole)[..., 1:] ** 2))


@pytest.mark.render
def test_positions_are_read_better_off_compressed_frames():
    errors = {"as red, green and blue": [], "by luma": []}
    model, size = get_system("acrobot").compile(), (64, 64)
    rng = np.random.default_rng(0)
    with Scene(model, "fixed", size, "fast") as scene:
        poses = rng.uniform([2.6, -0.5], [3.7, 0.5], (12, 2))
        film = np.stack([jpeg(scene.render(q, scene.nominal).astype(np.uint8), 92) for q in poses])
        still = film.mean(axis=0)
        for q, frame in zip(poses, film, strict=True):
            found = align(scene, scene.nominal, Light.unchanged(), frame.astype(np.float32), still, q + 0.02, near=True)
            errors["as red, green and blue"].append(found.q - q)
    halved = HalvedChroma.of([film])
    assert halved is not None
    with Scene(model, "fixed", size, "fast", halved) as scene:
        seen = halved.filmed(film).astype(np.float32)
        for q, frame in zip(poses, seen, strict=True):
            found = align(scene, scene.nominal, Light.unchanged(), frame, seen.mean(axis=0), q + 0.02, near=True)
            errors["by luma"].append(found.q - q)
    left = {name: float(np.sqrt(np.mean(np.square(error)))) for name, error in errors.items()}
    assert left["by luma"] < 0.8 * left["as red, green and blue"], left
