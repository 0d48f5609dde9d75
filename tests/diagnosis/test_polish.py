"""Lengths of links in compressed frames: the least squares, found without derivatives."""

import numpy as np
import pytest
from films import jpeg

from keycld_envs.systems import get_system
from keycld_model.image_alignment.chroma import HalvedChroma
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.polish import polished
from keycld_model.image_alignment.scene import Scene


@pytest.mark.render
def test_visible_lengths_are_found_in_compressed_frames():
    model, size, rng = get_system("acrobot").compile(), (64, 64), np.random.default_rng(0)
    poses, film = rng.uniform(-3, 3, (6, 2)), []
    with Scene(model, "fixed", size, "fast") as scene:
        true = scene.nominal.copy()
        for q in poses:
            noisy = scene.render(q, true) + rng.normal(0, 4, (*size, 3))
            film.append(jpeg(np.clip(np.round(noisy), 0, 255).astype(np.uint8), 85))
    halved = HalvedChroma.of([np.stack(film)])
    assert halved is not None
    with Scene(model, "fixed", size, "fast", halved) as scene:
        lengths = np.array([parameter.body is not None for parameter in scene.parameters])
        off = true.copy()
        off[lengths] = 0.02, -0.02  # the elbow is too far down
        frames = [
            (f, Light.unchanged(), q)
            for f, q in zip(halved.filmed(np.stack(film)).astype(np.float32), poses, strict=True)
        ]
        found, _ = polished(scene, off, np.diag(scene.look_steps())[lengths], frames)
    assert np.abs(found - true)[lengths].max() < 0.008
    assert found[~lengths] == pytest.approx(true[~lengths])
