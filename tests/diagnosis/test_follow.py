"""Poses of frames that follow each other."""

from functools import partial

import numpy as np
import pytest
from films import film, jpeg

from keycld_envs.systems import get_system
from keycld_model.image_alignment import follow as follow_module
from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.follow import _continued, follow
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import Pose
from keycld_model.image_alignment.scene import Scene


@pytest.mark.parametrize(("seen", "most"), [({}, 0.02), ({"develop": partial(jpeg, quality=75)}, 0.2)])
def test_a_link_that_turns_by_a_quarter_turn_a_frame_is_followed_turn_by_turn(seen, most):
    """Each frame is pixels away from where those before lead to; positions are fitted to the end all the same."""
    (run,), (truth,) = film("acrobot", 1, 60, **seen, qvel=(0.0, 45.0))
    assert np.abs(np.diff(truth[:, 1])).max() > 1.4 and np.ptp(truth[:, 1]) > 8 * np.pi
    assert run.frames is not None and run.t_frame is not None
    with Scene(get_system("acrobot").compile(), "fixed", (64, 64), "fast", None) as scene:
        poses = follow(scene, scene.nominal, Light.unchanged(), run.t_frame, run.frames, Bank(scene, scene.nominal))
    error = np.array([pose.q for pose in poses]) - truth
    assert all(pose.readable for pose in poses)
    assert np.abs(error - np.round(error[0] / (2 * np.pi)) * 2 * np.pi).max() < most


def test_poses_that_begin_where_those_around_lead_to_are_nearer(monkeypatch):
    """Edges in a few shades have many small minima; the first frames, which nothing leads to, ended in far ones."""
    (run,), (truth,) = film("acrobot", 1, 40, qvel=(2.0, -3.0))
    assert run.frames is not None and run.t_frame is not None
    errors = {}
    for again in (0, follow_module.AGAIN):
        monkeypatch.setattr(follow_module, "AGAIN", again)
        with Scene(get_system("acrobot").compile(), "fixed", (64, 64), "fast", None) as scene:
            poses = follow(scene, scene.nominal, Light.unchanged(), run.t_frame, run.frames, Bank(scene, scene.nominal))
        errors[again] = np.array([pose.q for pose in poses]) - truth
    before, after = (np.sqrt(np.mean(error**2, axis=0)) for error in errors.values())
    assert (after < 0.6 * before).all()


def poses_of(q: list[float], lost: slice = slice(0)) -> list[Pose]:
    """Of a hinge; those that are lost are wrong, and explain less than half of their frames."""
    wrong = range(*lost.indices(len(q)))
    return [
        Pose(np.array([100.0 if k in wrong else x]), np.eye(1), 1.0, 1.0, 0.45 if k in wrong else 0.97, 0.1, 1.0)
        for k, x in enumerate(q)
    ]


@pytest.mark.parametrize(
    ("lost", "expected"),
    [
        (slice(0, 3), 49),  # constant acceleration
        (slice(6, 7), 25 + 2 * (25 - 16)),  # constant speed
        (slice(5, 6), 36 + (36 - 16) / 2),
        (slice(4, 7), 9),  # it may have turned back
    ],
)
def test_frames_that_were_lost_do_not_tell_where_a_mechanism_goes_on(lost, expected):
    there = _continued(np.arange(8.0), poses_of([k**2 for k in range(7)], lost))
    assert there is not None
    np.testing.assert_allclose(there, expected, rtol=1e-9)
