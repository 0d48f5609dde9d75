"""Sealed cases that a camera saw."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from keycld_control.benchmarks.blind.case import HELD_OUT, TRAINING, draw_case
from keycld_control.benchmarks.blind.film import SIZE, UNSEEN, Film, Studio, lengthen
from keycld_control.benchmarks.blind.grade import gain
from keycld_control.benchmarks.blind.make import Settings, make
from keycld_control.benchmarks.blind.parameter_errors import ParameterErrors
from keycld_envs.recordings import read_dataset
from keycld_envs.systems import get_system

SEED = 798
"""A pendulum, the cheapest."""


@pytest.mark.render
@pytest.mark.long
def test_filmed_cases_have_frames_and_commands_and_nothing_else(tmp_path):
    make(tmp_path / "made", Settings(SEED, 1, "pixels"))
    folder = tmp_path / "made" / "cases" / "0001"
    runs = [r for part in ("training", "held_out") for r in read_dataset(folder / part).recordings]
    assert len(runs) == TRAINING + HELD_OUT
    for run in runs:
        assert run.qpos is None and run.qvel is None
        assert run.load_frames().shape[1:] == (SIZE, SIZE, 3)
        assert run.action is not None
    assert json.loads((folder / "case.json").read_text())["observe"] == "pixels"
    (answer,) = json.loads((tmp_path / "made" / "answers.json").read_text())
    assert set(answer["film"]) >= {"right", "up", "zoom", "aspect", "roll", "gain", "noise", "shifted"}
    assert "film" not in (folder / "case.json").read_text()


def test_links_look_as_long_as_they_are():
    errors = ParameterErrors({}, {"upper_arm": 0.8, "lower_arm": 1.2})
    model = get_system("acrobot").compile()
    lengthen(model, errors)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    arm = model.geom("lower_arm").id
    along = data.geom_xmat[arm].reshape(3, 3)[:, 2] * model.geom_size[arm, 1]
    ends = sorted(float(point[2]) for point in (data.geom_xpos[arm] + along, data.geom_xpos[arm] - along))
    assert ends == pytest.approx([2.1 + 0.8, 2.1 + 0.8 + 1.2], abs=1e-9)
    nominal = get_system("acrobot").compile()
    lengthen(nominal, ParameterErrors({}, {}))
    assert np.array_equal(nominal.geom_size, get_system("acrobot").compile().geom_size)


@pytest.mark.render
def test_frames_tell_positions_the_better_the_less_is_between():
    """Never better than .03 pixels, of which a rad is 15 at the end of the pendulum."""
    still = Film.draw(np.random.default_rng(1))
    films = [
        replace(still, blur=0.2, noise=noise, jpeg=jpeg) for noise, jpeg in ((0.0, None), (10.0, None), (10.0, 75))
    ]
    positions, rng = np.linspace(0, 6, 8)[:, None], np.random.default_rng(0)
    with Studio("pendulum", ParameterErrors({}, {})) as studio:
        clean, noisy, compressed = (float(studio.reading_deviation(positions, film, rng)[0]) for film in films)
    assert clean == pytest.approx(0.03 / 15, rel=0.15)
    assert clean < noisy < compressed < 0.01


@pytest.mark.render
def test_what_is_out_of_view_is_not_known():
    film = replace(Film.draw(np.random.default_rng(1)), right=0.0)
    with Studio("cartpole", ParameterErrors({}, {})) as studio:
        away = studio.reading_deviation(np.array([[20.0, 0.0]] * 3), film, np.random.default_rng(0))
    assert (away == UNSEEN).all()


@pytest.mark.render
def test_a_part_counts_as_seen_where_the_camera_shows_it():
    """Where the middle of the cart is in the image, by geometry, its frame is not the empty one."""
    cart = np.linspace(-4.0, 4.0, 81)
    positions, rng = np.stack([cart, np.full_like(cart, np.pi)], axis=1), np.random.default_rng(0)
    film = replace(Film.draw(np.random.default_rng(1)), noise=0.0, jpeg=None, right=5.0, roll=0.1, nearer=0.1)
    with Studio("cartpole", ParameterErrors({}, {})) as studio:
        shown = studio.in_image(positions, film)
        empty, frames = studio.shoot(np.array([[20.0, np.pi]]), film, rng), studio.shoot(positions, film, rng)
    drawn = (np.abs(frames.astype(int) - empty.astype(int)).max(axis=-1) > 8).sum(axis=(1, 2))
    assert shown.any() and not shown.all()
    assert drawn[shown].min() > 0.45 * drawn.max()
    assert drawn[~shown].max() < 0.75 * drawn.max()


def test_what_the_camera_does_not_show_is_not_graded():
    """A late sensor in a recording that is driven out of the image, and is seen in one window of five."""
    case, signals = draw_case(Settings(30113001, 43, "pixels", ("null", "one")).plans[23], (30113001, 1, 23), True)
    assert case.mechanisms[0].id == "sensor_latency"
    noise = np.array([0.0033, 0.0039])
    assert gain(case, signals, noise) < 0.3 * gain(replace(case, film=None), signals, noise)


def test_a_third_of_the_films_look_otherwise():
    films = [Film.draw(np.random.default_rng(i)) for i in range(600)]
    shifted = [film.shifted for film in films]
    assert np.mean(shifted) == pytest.approx(1 / 3, abs=0.06)
    assert max(film.noise for film in films if not film.shifted) <= 3
    assert all(film.jpeg is None for film in films if not film.shifted)
