"""Lengths of links, and blur, in compressed frames: the least squares, found without derivatives."""

import numpy as np
import pytest
from films import jpeg
from numpy.typing import NDArray

from keycld_envs.systems import get_system
from keycld_model.image_alignment.chroma import HalvedChroma
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.polish import best_blur, polished
from keycld_model.image_alignment.scene import Scene

Frames = list[tuple[NDArray[np.float32], Light, NDArray[np.float64]]]


def compressed(blur: float) -> tuple[Frames, HalvedChroma]:
    """Six frames of an acrobot, blurred by so many square pixels, with noise, and their poses."""
    rng, film = np.random.default_rng(0), []
    poses = rng.uniform(-3, 3, (6, 2))
    with Scene(get_system("acrobot").compile(), "fixed", (64, 64), "fast") as scene:
        for q in poses:
            noisy = scene.render(q, np.append(scene.nominal[:-1], blur)) + rng.normal(0, 4, (64, 64, 3))
            film.append(jpeg(np.clip(np.round(noisy), 0, 255).astype(np.uint8), 85))
    halved = HalvedChroma.of([np.stack(film)])
    assert halved is not None
    frames = halved.filmed(np.stack(film)).astype(np.float32)
    return [(f, Light.unchanged(), q) for f, q in zip(frames, poses, strict=True)], halved


@pytest.mark.render
def test_visible_lengths_are_found_in_compressed_frames():
    frames, halved = compressed(0.0)
    with Scene(get_system("acrobot").compile(), "fixed", (64, 64), "fast", halved) as scene:
        lengths = np.array([parameter.body is not None for parameter in scene.parameters])
        off = scene.nominal.copy()
        off[lengths] = 0.02, -0.02  # the elbow is too far down
        found, _ = polished(scene, off, np.diag(scene.look_steps())[lengths], frames)
        assert np.abs(found - scene.nominal)[lengths].max() < 0.008
        assert found[~lengths] == pytest.approx(scene.nominal[~lengths])


@pytest.mark.render
def test_blur_is_found_in_compressed_frames():
    """Wherever the search begins; compression blurs what is sharp, and does little to what is not."""
    found = {}
    for blur in (0.0, 0.6):
        frames, halved = compressed(blur)
        with Scene(get_system("acrobot").compile(), "fixed", (64, 64), "fast", halved) as scene:
            looks = [np.append(scene.nominal[:-1], start) for start in (0.0, 0.25, 2.0)]
            found[blur] = [best_blur(scene, look, frames) for look in looks]
    assert found[0.6] == pytest.approx([0.6] * 3, abs=0.06)
    assert 0 < max(found[0.0]) < 0.2
    assert np.ptp(found[0.0]) < 0.01
