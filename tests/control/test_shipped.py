"""The shipped weights, from pixels."""

from dataclasses import replace

import pytest

from keycld_control.closed_loop import LoopSettings
from keycld_control.swingup import swing_up
from keycld_control.video import film
from keycld_envs import REFERENCE_SYSTEMS, get_system
from keycld_envs.disturbance import Disturbance
from keycld_model.stored import shipped_models

pytestmark = pytest.mark.render
SEED = 10_000
WEAK = [name for name in REFERENCE_SYSTEMS if get_system(name).weak_limit is not None]


def settings(name: str, **options) -> LoopSettings:
    if name not in shipped_models():
        pytest.skip(f"no weights for {name} in this installation")
    return LoopSettings(name, seed=SEED, **options)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["random", pytest.param("hanging", marks=pytest.mark.long)])
@pytest.mark.parametrize("name", REFERENCE_SYSTEMS)
def test_they_swing_up(name, start):
    result = swing_up(settings(name, start=start), episodes=1)
    assert result.successes == 1
    assert result.median_time_to_upright_s < 5


@pytest.mark.long
@pytest.mark.parametrize("name", REFERENCE_SYSTEMS)
@pytest.mark.parametrize(
    "disturbance",
    [
        Disturbance(right=-1.5, up=2),
        Disturbance(gain=(0.7, 0.7, 0.7)),
        Disturbance(gain=(1.3, 1.3, 1.3)),
        Disturbance(noise=10),
    ],
    ids=["shifted", "darker", "brighter", "noisy"],
)
def test_they_swing_up_before_another_camera(name, disturbance):
    assert swing_up(settings(name, start="random", disturbance=disturbance), episodes=1).successes == 1


@pytest.mark.long
@pytest.mark.parametrize("name", WEAK)
def test_they_pump_where_motors_are_weak(name):
    limit = get_system(name).weak_limit
    assert swing_up(settings(name, start="hanging", action_limit=limit), episodes=1).successes == 1


@pytest.mark.long
def test_the_result_does_not_depend_on_the_workers():
    alone = swing_up(settings("pendulum"), episodes=2)
    together = swing_up(settings("pendulum"), episodes=2, workers=2)
    assert replace(alone, act_per_second=0.0) == replace(together, act_per_second=0.0)


@pytest.mark.long
def test_clips_are_written(tmp_path):
    episode = film(settings("pendulum", start="hanging"), tmp_path / "clip.mp4")
    assert episode.success
    assert (tmp_path / "clip.mp4").stat().st_size > 10_000
