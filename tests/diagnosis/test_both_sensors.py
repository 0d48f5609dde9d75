"""Encoders and a camera at once."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from plants import recordings

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose, diagnose_images, from_images
from keycld_model.diagnosis.inputs.observation.encoders_and_camera import SEEN, EncodersAndCamera, joined


def seen_by_camera(run: Recording, error: float, offset: float = 0.0, seed: int = 0) -> Recording:
    """The same run as a camera reads it, at other times."""
    assert run.t_state is not None
    t = np.asarray(run.t_state)[::2] + offset
    t = t[t <= run.t_state[-1]]
    q = at(run, t) + np.random.default_rng(seed).normal(0, error, (len(t), len(run.joint_names)))
    return replace(run, t_state=t, qpos=q, qvel=None, units={**run.units, "qpos": ("rad",) * len(run.joint_names)})


def at(run: Recording, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Joint positions at times."""
    q = run.positions_at(times)
    assert q is not None
    return q


def positions(run: Recording) -> NDArray[np.float64]:
    """All channels."""
    assert run.qpos is not None
    return run.qpos


def test_channels_are_those_of_both_at_the_times_of_the_slower_sensor():
    (run,) = recordings("acrobot", 1, number=1, seconds=2.0)
    camera = seen_by_camera(run, 0.002, offset=0.003)
    both = joined(run, camera)
    assert both.joint_names == ("shoulder", "elbow", "shoulder" + SEEN, "elbow" + SEEN)
    clock = np.asarray(both.t_state)
    assert np.array_equal(clock, np.asarray(camera.t_state))
    assert np.array_equal(positions(both)[:, 2:], positions(camera))
    assert np.abs(positions(both)[:, :2] - at(run, clock)).max() < 0.01


def test_a_missing_sample_of_one_sensor_is_missing_there_alone():
    (run,) = recordings("pendulum", 1, number=1, seconds=2.0)
    q = np.array(run.qpos)
    q[10:13] = np.nan
    both = joined(replace(run, qpos=q), seen_by_camera(run, 0.002))
    lost = np.isnan(positions(both)[:, 0])
    assert lost.any() and lost.sum() < 5
    assert np.isfinite(positions(both)[:, 1]).all()
    model = get_system("pendulum").compile()
    assert np.isfinite(EncodersAndCamera(model, np.array([0.002])).positions(positions(both))).all()


def test_sensors_that_were_never_on_at_once_are_refused():
    (run,) = recordings("pendulum", 1, number=1, seconds=2.0)
    later = replace(seen_by_camera(run, 0.002), t_state=np.asarray(run.t_state)[::2] + 100.0)
    with pytest.raises(InputError, match="never on at once"):
        joined(run, later)


@pytest.mark.long
def test_both_sensors_name_what_is_missing_with_a_noise_of_their_own():
    runs = recordings("pendulum", 3, lambda t, q, v, u: -0.1 * v, number=6, seconds=2.0)
    both = [joined(run, seen_by_camera(run, 0.004, seed=i)) for i, run in enumerate(runs)]
    model = get_system("pendulum").compile()
    report = diagnose(both, model, observation=EncodersAndCamera(model, np.array([0.004])))
    assert [(f.effect, f.where["name"]) for f in report.findings] == [("viscous_friction", "hinge")]
    assert report.findings[0].parameters["b"].value == pytest.approx(0.1, rel=0.1)
    assert report.details["noise"][1] == pytest.approx(0.004, rel=0.3)
    assert report.details["noise"][0] < 0.003


@pytest.mark.parametrize("lost", ["all positions", "one joint"])
def test_encoders_that_tell_nothing_are_refused_before_frames_are_read(lost, monkeypatch):
    (run,) = recordings("acrobot", 1, number=1, seconds=2.0)
    clock = np.asarray(run.t_state)[::2]
    q = np.array(run.qpos)
    q[:, 1] = np.nan
    kept = {"qpos": q} if lost == "one joint" else {"qpos": None, "t_state": None, "qvel": None}
    film = np.zeros((len(clock), 8, 8, 3), np.uint8)
    filmed = replace(run, t_frame=clock, frames=film, **kept)  # pyright: ignore[reportArgumentType]
    monkeypatch.setattr(from_images, "read_positions", lambda *_: pytest.fail("frames were read"))
    says = "misses more than half of the samples of 'elbow'" if lost == "one joint" else "no joint positions beside"
    with pytest.raises(InputError, match=says):
        diagnose_images([filmed], get_system("acrobot").compile(), encoders=True)
