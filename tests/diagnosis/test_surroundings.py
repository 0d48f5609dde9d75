"""The camera, told from what does not move."""

from dataclasses import replace

import numpy as np
import pytest
from films import film, jpeg
from numpy.typing import NDArray

from keycld_envs.rendering import View
from keycld_envs.systems import get_system
from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.chroma import HalvedChroma
from keycld_model.image_alignment.fit_look import MARKED, fit_look
from keycld_model.image_alignment.look import view_of
from keycld_model.image_alignment.scene import STEP, Scene
from keycld_model.image_alignment.surroundings import Surroundings, Told, _far_in_place, unclipped

TRUE = np.array([2.37, -1.24, -0.0056, -0.0089, 0.0459, 0.021, -0.034, 0.02, -0.015, 0.01, 0.0, 0.0])
"""Ten numbers of a view of the cartpole, the length of its pole, and no blur."""
OFF = np.array([-0.11, -0.03, -0.001, 0.0043, 0.0003, -0.01, 0.007, 0.002, -0.002, 0.005, 0.0, 0.0])


def filmed_with(offset: float) -> tuple[list[NDArray[np.uint8]], list[NDArray[np.float64]]]:
    """Frames of a cartpole in a light with an offset, and where it is in some of them."""
    rng = np.random.default_rng(0)
    right, up, zoom, aspect, *others = TRUE[:10]
    view = View(right, up, float(np.exp(zoom)), float(np.exp(aspect)), *others, distance=6.0)

    def develop(image):
        noisy = image * np.array([1.18, 0.94, 1.1]) + offset + rng.normal(0, 5, image.shape)
        return np.clip(noisy, 0, 255).round().astype(np.uint8)

    runs, truth = film("cartpole", runs=2, frames=30, view=view, develop=develop)
    return [np.asarray(run.frames) for run in runs], [q for positions in truth for q in positions[::10]]


@pytest.fixture(scope="module")
def filmed():
    return filmed_with(-7.0)


@pytest.mark.render
def test_still_pixels_tell_the_camera_far_better_than_a_step_of_a_drawing(filmed):
    films, positions = filmed
    with Scene(get_system("cartpole").compile(), "fixed", (64, 64), "fast") as scene:
        told = Surroundings.of(films).camera(scene, TRUE + OFF, positions)
        assert told is not None
        pixels = 0.7 * np.abs((told.look - TRUE) / scene.look_steps())[:10]
    assert pixels.max() < 0.01
    assert told.look[10] == 0.0  # links move
    assert not len(told.loose)


@pytest.mark.render
def test_a_camera_that_cuts_off_what_is_dark_is_told_as_well():
    """A tenth of the pixels are black in some frames or all, so that their mean is brighter than what they show."""
    films, positions = filmed_with(-35.0)
    assert np.mean(films[0] == 0) > 0.05
    with Scene(get_system("cartpole").compile(), "fixed", (64, 64), "fast") as scene:
        told = Surroundings.of(films).camera(scene, TRUE + OFF, positions)
        assert told is not None and told.exact
        pixels = 0.7 * np.abs((told.look - TRUE) / scene.look_steps())[:10]
    assert pixels.max() < 0.01


@pytest.mark.parametrize("shown", [-2.0, 0.0, 3.0, 10.0, 100.0, 250.0, 256.0])
def test_what_is_cut_off_at_black_and_white_is_told_from_the_mean(shown):
    frames = np.clip(np.round(shown + np.random.default_rng(0).normal(0, 6, 20_000)), 0, 255)
    told = unclipped(np.array([frames.mean()], np.float32), 6.0)
    assert told == pytest.approx(shown, abs=0.2)


@pytest.mark.render
def test_where_all_that_is_still_is_far_away_the_mechanism_tells_whether_it_is_shifted(filmed):
    """Such pixels are as well explained by a camera that stands elsewhere, and what the mechanism told is kept."""
    films, positions = filmed
    far = Surroundings.of(films)
    far = replace(far, still=far.still & (np.arange(64) < 24)[:, None])  # no rail, and no floor near it
    with Scene(get_system("cartpole").compile(), "fixed", (64, 64), "fast") as scene:
        told = far.camera(scene, TRUE, positions)
        assert told is not None and len(told.loose)
        names, steps = [p.name for p in scene.parameters], scene.look_steps()
        assert len(told.loose) == 3  # up and larger together, too
        assert all(way[names.index("pitch")] == 0.0 for way in told.loose)
        rolled = 0.3 * steps * (np.arange(len(steps)) == names.index("roll"))
        again = far.camera(scene, TRUE + 0.5 * told.loose[0] + rolled, positions, told.loose)
    assert again is not None
    off, ways = (again.look - TRUE) / steps, told.loose / steps
    kept = np.linalg.lstsq(ways.T, off, rcond=None)[0]
    assert kept == pytest.approx([0.5, *[0.0] * (len(ways) - 1)], abs=0.1)
    assert abs(off[names.index("roll")]) < 0.03


@pytest.mark.render
def test_a_mechanism_moves_before_what_is_far_away():
    with Scene(get_system("cartpole").compile(), "fixed", (64, 64), "fast") as scene:
        q = np.array([0.2, 2.0])
        here, still = scene.render(q, TRUE), np.arange(64) < 24
        for pixels in (1.0, -3.0):
            for k, there in enumerate(_far_in_place(scene, TRUE, pixels)):
                drawn = scene.render(q, there)
                assert np.mean((drawn - here)[still] ** 2) < 0.01
                assert np.mean((drawn - here)[~still] ** 2) > 1
                ends = [np.array(view_of(look).place(0.0, 0.0, scene.focal)) for look in (TRUE, there)]
                assert ends[1] - ends[0] == pytest.approx(pixels * np.array([k == 0, k == 1]), abs=1e-9)


@pytest.mark.render
def test_surroundings_that_are_not_drawn_tell_nothing(filmed):
    films, positions = filmed
    elsewhere = [np.roll(frames, 20, axis=1) for frames in films]
    flat = [np.full_like(frames, 90) for frames in films]
    flicker = [frames // 2 + (np.arange(30) % 2 * 120).astype(np.uint8)[:, None, None, None] for frames in films]
    with Scene(get_system("cartpole").compile(), "fixed", (64, 64), "fast") as scene:
        for other in (elsewhere, flat):
            assert Surroundings.of(other).camera(scene, TRUE, positions) is None
        assert Surroundings.of(flicker).still.any()  # light that flickers everywhere is no motion


@pytest.fixture(scope="module")
def compressed():
    """A pendulum, seen from elsewhere, as frames of JPEG have it; and the look of its scene."""
    true, rng = (
        np.array([1.1, 1.2, -0.03, -0.007, 0.004, 0.03, -0.008, -0.01, -0.005, -0.02, 0.0, 0.0]),
        np.random.default_rng(0),
    )
    right, up, zoom, aspect, *others = true[:10]
    view = View(right, up, float(np.exp(zoom)), float(np.exp(aspect)), *others, distance=2.5)

    def develop(image):
        return jpeg(np.clip(image + rng.normal(0, 4, image.shape), 0, 255).round().astype(np.uint8), 83)

    runs, truth = film("pendulum", runs=2, frames=40, view=view, develop=develop)
    films = [np.asarray(run.frames) for run in runs]
    halved = HalvedChroma.of(films)
    assert halved is not None
    return true, [halved.filmed(frames) for frames in films], [q for positions in truth for q in positions[::8]], halved


@pytest.mark.render
@pytest.mark.long
def test_where_compression_leaves_marks_the_camera_is_told_but_not_exactly(compressed):
    true, films, positions, halved = compressed
    with Scene(get_system("pendulum").compile(), "fixed", (64, 64), "fast", halved) as scene:
        told = Surroundings.of(films).camera(scene, true, positions)
        assert told is not None and not told.exact
        pixels = STEP * np.abs((told.look - true) / scene.look_steps())[:10]
    assert 0.01 < pixels.max() < 0.3


@pytest.mark.render
@pytest.mark.parametrize("pixels", [0.0, pytest.param(1.0, marks=pytest.mark.long)])
def test_such_a_camera_is_kept_if_it_leaves_less_of_the_frames(compressed, monkeypatch, pixels):
    true, films, _, halved = compressed
    stills = [np.median(frames, axis=0).astype(np.float32) for frames in films]
    frames = [(r, frame.astype(np.float32)) for r, taken in enumerate(films) for frame in taken[::20]]
    with Scene(get_system("pendulum").compile(), "fixed", (64, 64), "fast", halved) as scene:
        off = true + pixels / STEP * scene.look_steps() * (np.arange(len(true)) == 1)
        told = Told(off, np.zeros((0, len(true))), exact=False)
        monkeypatch.setattr(Surroundings, "camera", lambda *_: told)
        look = fit_look(scene, stills, frames, Bank(scene, scene.nominal), Surroundings.of(films))
    kept = look.values[:10] == pytest.approx(off[:10], abs=1e-9)
    assert kept == (pixels == 0.0)


@pytest.mark.render
def test_looks_are_less_certain_where_compression_leaves_marks_on_what_is_still(filmed, compressed, monkeypatch):
    with Scene(get_system("cartpole").compile(), "fixed", (64, 64), "fast") as scene:
        assert not Surroundings.of(filmed[0]).marked(scene, TRUE, filmed[1])
    true, films, positions, halved = compressed
    around = Surroundings.of(films)
    stills = [np.median(frames, axis=0).astype(np.float32) for frames in films]
    frames = [(r, frame.astype(np.float32)) for r, taken in enumerate(films) for frame in taken[::20]]
    monkeypatch.setattr(Surroundings, "camera", lambda *_: None)
    with Scene(get_system("pendulum").compile(), "fixed", (64, 64), "fast", halved) as scene:
        assert around.marked(scene, true, positions)
        bank = Bank(scene, scene.nominal)
        marked = fit_look(scene, stills, frames, bank, around)
        monkeypatch.setattr(Surroundings, "marked", lambda *_: False)
        clean = fit_look(scene, stills, frames, bank, around)
    assert marked.values == pytest.approx(clean.values)
    assert marked.deviation == pytest.approx(MARKED * clean.deviation)
