"""Scores, against their definitions."""

import json
from dataclasses import asdict, replace

import mujoco
import numpy as np
import pytest
from swinging import CONFIG, dataset, random_parameters

from keycld_envs import REFERENCE_SYSTEMS, get_system
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_model import WorldModel
from keycld_model.evaluation import evaluate, prediction_errors, static_error, valid_frames
from keycld_model.evaluation.joint_coordinates import (
    circular_r2,
    joint_angles,
    linear_r2,
    matched,
    slider_positions,
    wrap,
)
from keycld_model.stored import shipped_models

SYSTEM = "KeyCLD/Pendulum-v0"


def test_static_error_is_that_of_the_mean_frame():
    frames = np.random.default_rng(0).integers(0, 256, (3, 4, 5, 6, 3), np.uint8)
    values = frames / 255.0
    naive = np.mean((values - values.mean((0, 1))) ** 2)
    assert static_error(frames) == pytest.approx(naive, rel=1e-6)
    assert static_error(np.full_like(frames, 7)) == pytest.approx(0, abs=1e-9)


def test_valid_frames():
    nan, inf = np.nan, np.inf
    errors = np.array([
        [0.0, 0.1, 0.2, 0.3],  # never above the threshold, which itself is valid
        [0.0, 0.4, 0.0, 0.0],  # what comes after does not count
        [0.4, 0.0, 0.0, 0.0],
        [0.0, 0.0, nan, 0.0],
        [0.0, 0.0, 0.0, inf],
        [nan, nan, nan, nan],
    ])  # fmt: skip
    assert valid_frames(errors, 0.3).tolist() == [4, 1, 0, 2, 3, 0]


def test_circular_r2():
    rng = np.random.default_rng(0)
    true = rng.uniform(-np.pi, np.pi, 500)
    assert circular_r2(wrap(true + 2.5), true + 2 * np.pi) == pytest.approx(1)
    assert circular_r2(-true + 1.0, true) == pytest.approx(1)
    noise = 0.1 * rng.normal(size=500)
    assert circular_r2(true + noise, true) == pytest.approx(1 - 0.01 / (np.pi**2 / 3), abs=1e-3)
    assert circular_r2(rng.uniform(-np.pi, np.pi, 500), true) < 0.1
    assert circular_r2(2 * true, true) < 0.5
    narrow = np.pi + 0.1 * rng.normal(size=500)  # across the seam
    assert circular_r2(wrap(narrow), narrow) == pytest.approx(1)


def test_keypoints_of_two_poles_may_follow_either():
    cart = Mechanism(4, 3, rods=(Rod(0, 1), Rod(0, 2), Rod(2, 3)), sliders=(Slider(0),))
    poles = Mechanism(3, 3, rods=(Rod(0, 1), Rod(0, 2)), sliders=(Slider(0),))
    true = np.random.default_rng(0).uniform(-np.pi, np.pi, (5, 40, 3))
    seen = wrap(true + np.array([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(matched(poles, seen[..., [1, 0]], true[..., :2]), seen[..., :2])
    np.testing.assert_array_equal(matched(poles, seen[..., :2], true[..., :2]), seen[..., :2])
    np.testing.assert_array_equal(matched(cart, seen, true), seen)
    np.testing.assert_array_equal(
        matched(cart, seen[..., [1, 0, 2]], true), seen[..., [1, 0, 2]]
    )  # one carries another


def test_linear_r2():
    true = np.random.default_rng(0).normal(size=200)
    assert linear_r2(-3 * true + 1, true) == pytest.approx(1)
    assert linear_r2(np.random.default_rng(1).normal(size=200), true) < 0.05


@pytest.mark.parametrize("name", REFERENCE_SYSTEMS)
def test_joint_coordinates_of_true_keypoints_are_qpos(name):
    system = get_system(name)
    model = system.compile()
    data = mujoco.MjData(model)
    qpos = np.random.default_rng(0).uniform(-np.pi, np.pi, (40, model.nq))
    keypoints = []
    for q in qpos:
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        keypoints.append(system.keypoints(model, data))
    keypoints = np.array(keypoints)
    angles, slides = joint_angles(system.mechanism, keypoints), slider_positions(system.mechanism, keypoints)
    hinges = [i for i, joint in enumerate(system.joints) if joint.kind == "hinge"]
    np.testing.assert_allclose(wrap(angles - qpos[:, hinges]), 0, atol=1e-6)
    for column, i in enumerate(i for i, joint in enumerate(system.joints) if joint.kind == "slide"):
        scale = slides[:, column] / qpos[:, i]
        np.testing.assert_allclose(scale, scale[0])
        assert scale[0] > 0


def test_a_slanted_slider_counts_along_its_rail():
    mechanism = Mechanism(1, 1, sliders=(Slider(0, (-0.6, 0.8)),), pivot=(0.1, 0.0))
    np.testing.assert_allclose(slider_positions(mechanism, np.array([[0.1 + 0.8 * 0.5, 0.6 * 0.5]])), [0.5])
    assert joint_angles(mechanism, np.zeros((3, 1, 2))).shape == (3, 0)


@pytest.fixture(scope="module")
def model():
    config = replace(CONFIG, system=SYSTEM)
    return WorldModel(config, random_parameters(CONFIG), "a test", {})


def recorded(**options):
    return dataset(**({"system": SYSTEM} | options))


@pytest.mark.slow
def test_scores_are_their_definitions(model):
    data = recorded(count=4)
    scores = evaluate(model, data, context=3)
    frames = np.stack([r.load_frames() for r in data.recordings])
    actions = np.stack([r.action for r in data.recordings if r.action is not None])
    assert (scores.split, scores.sequences, scores.frames, scores.context) == ("all", 4, 12, 3)
    assert scores.epsilon == pytest.approx(static_error(frames))
    valid = []
    for images, u in zip(frames, actions, strict=True):
        predicted = model.predict(images[:3], u, 12).frames
        bad = np.mean((predicted - images / 255.0) ** 2, (1, 2, 3)) > scores.epsilon
        valid.append(int(bad.argmax()) if bad.any() else 12)
    assert scores.vpt_fraction == pytest.approx(np.mean(valid) / 12)
    assert scores.vpt_full == valid.count(12)
    assert scores.vpt_frame_index == pytest.approx(np.mean(np.minimum(valid, 11)))
    drawn = model.render(model.keypoints(frames))
    assert scores.reconstruction_mse == pytest.approx(np.mean((drawn - frames / 255.0) ** 2), rel=1e-4)
    still = np.broadcast_to(model.keypoints(frames).mean(axis=(0, 1)), (12, 1, 2))  # the only one: nobody else tells
    more = np.mean((model.render(still) - frames / 255.0) ** 2) - scores.reconstruction_mse
    assert scores.keypoint_contributions == pytest.approx((more / scores.epsilon,), rel=1e-3, abs=1e-6)
    lengths = np.linalg.norm(model.keypoints(frames)[:, :, 0], axis=-1)
    assert scores.constraint_residual == pytest.approx(np.median(np.abs(lengths - 0.5)), rel=1e-3)
    assert scores.vpt_interval[0] <= scores.vpt_fraction <= scores.vpt_interval[1]
    json.dumps(asdict(scores))


@pytest.mark.slow
def test_of_its_own_data_only_the_held_out_part_counts(model, monkeypatch):
    data = recorded(count=4)
    held_out = replace(data, recordings=data.split(0.5)[1].recordings)
    apart = evaluate(model, held_out, context=3)
    for key, value in {"data": {"sha256": data.sha256}, "validation": 0.5, "epsilon": 0.25}.items():
        monkeypatch.setitem(model.meta, key, value)
    scores = evaluate(model, data, context=3)
    assert (scores.split, scores.sequences, scores.frames, scores.epsilon) == ("validation", 2, 12, 0.25)
    assert scores.reconstruction_mse == pytest.approx(apart.reconstruction_mse)


@pytest.mark.slow
def test_long_recordings_are_cut(model):
    scores = evaluate(model, recorded(count=2, length=25), context=3, frames=12)
    assert (scores.sequences, scores.frames) == (4, 12)


@pytest.mark.slow
def test_joints_are_scored_where_qpos_is_recorded(model):
    data = recorded(count=4)
    scores = evaluate(model, data, context=3)
    assert scores.circular_r2 is not None and scores.circular_r2.keys() == {"hinge"}
    blind = recorded(count=4, t_state=None, qpos=None, units={"action": "N m"})
    assert evaluate(model, blind, context=3).circular_r2 is None


def test_a_prediction_that_is_not_finite_is_not_valid(model):
    frames = recorded(count=1).sequences().frames
    broken = random_parameters(CONFIG)
    broken["dynamics"]["potential"]["out"]["kernel"][:] = np.nan
    errors = prediction_errors(model.with_parameters(broken), frames, np.zeros((1, 11, 1)), 3)
    assert valid_frames(errors, 1.0).tolist() == [0]


@pytest.mark.parametrize(
    ("options", "changes", "words"),
    [
        ({"frames": 0}, {}, "frames"),
        ({"context": 1}, {}, "context"),
        ({"context": 13}, {}, "context"),
        ({}, {"system": "KeyCLD/Acrobot-v0"}, "KeyCLD/Acrobot-v0"),
        ({}, {"t_frame": 0.01 * np.arange(12)}, "0.01 s"),
        ({}, {"frames": np.zeros((12, 24, 16, 3), np.uint8)}, "24, 16"),
        ({}, {"t_action": None, "action": None, "actuator_names": (), "units": {"qpos": "rad"}}, "0 actions"),
        ({}, {"action": np.zeros((11, 2)), "actuator_names": ("a", "b")}, "actions"),
    ],
)
def test_data_that_do_not_fit_are_refused(model, options, changes, words):
    with pytest.raises(InputError, match=words):
        evaluate(model, recorded(count=2, **changes), **options)


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize(
    "name", ["pendulum", *(pytest.param(n, marks=pytest.mark.long) for n in ("cartpole", "acrobot"))]
)
def test_the_shipped_weights(name, tmp_path):
    """No worse than a sample of 10 recordings can tell; `keycld bench` measures what they reach."""
    if name not in shipped_models():
        pytest.skip(f"no weights for {name} in this installation")
    from keycld_envs import resolve_env_id
    from keycld_envs.collect import CollectSettings, collect
    from keycld_envs.recordings import read_dataset

    collect(tmp_path / "data", CollectSettings(resolve_env_id(name), seed=10_000), episodes=10)
    model = WorldModel.load(name)
    scores = evaluate(model, read_dataset(tmp_path / "data"))
    assert scores.split == "all"
    assert scores.vpt_fraction > (0.85 if name == "cartpole" else 0.95)
    assert scores.circular_r2 is not None and min(scores.circular_r2.values()) > 0.995
    assert scores.constraint_residual < 0.01
    assert model.meta is not None and scores.epsilon == model.meta["epsilon"]
    assert sum(path.stat().st_size for path in shipped_models()[name].iterdir()) <= 3e6
