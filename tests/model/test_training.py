"""Training: exact resume, refusals, detection of what goes wrong, and the paper's loss."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import CONFIG, MECHANISM, NETWORKS, SIZE, TIMESTEP, dataset, random_parameters, recordings

from keycld_envs.errors import InputError
from keycld_envs.files import one_writer
from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_envs.recordings import read_dataset, write_recording
from keycld_model import WorldModel
from keycld_model.checkpoint import flatten, read_checkpoint, write_checkpoint
from keycld_model.config import PAPER_NETWORKS
from keycld_model.evaluation import prediction_errors
from keycld_model.modules import Parts
from keycld_model.places import (
    end_rods,
    lean_along_rails,
    rails,
    slide_along_rods,
    sliding_rods,
    to_keypoints,
    to_masses,
)
from keycld_model.training import PRESETS, Preset, TrainingData, TrainingError, loop, relocate, train
from keycld_model.training.align import Align
from keycld_model.training.discover import Discover
from keycld_model.training.distil import Distil
from keycld_model.training.fit import FitTrajectories, FitWindows
from keycld_model.training.joint import Joint
from keycld_model.training.keypoint_tables import keypoint_table, local_polynomials

pytestmark = pytest.mark.usefixtures("unoptimised")

TINY = Preset(
    NETWORKS,
    (
        Discover(steps=6, batch=4, learning_rate=1e-3),
        FitWindows(steps=4, batch=4, learning_rate=1e-3, window=4),
        FitTrajectories(steps=4, batch=4, learning_rate=1e-3, restart=True, identify=2),
        Distil(steps=4, batch=4, learning_rate=1e-3),
    ),
)
SHORT = replace(TINY, stages=TINY.stages[:1])


class Killed(Exception):
    pass


@pytest.fixture(scope="module", autouse=True)
def quick_start():
    """Random weights, which take no time to draw, and scores from keypoints alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Parts, "initial", initial)
        patch.setattr(loop, "prediction_errors", rough_errors)
        yield


def rough_errors(*arguments, refine=False):
    return prediction_errors(*arguments, refine=False)


def initial(parts, seed):
    return random_parameters(parts.config, seed)


@pytest.fixture(autouse=True)
def log_and_save_every_step(monkeypatch):
    monkeypatch.setattr(loop, "LOG_EVERY", 1)
    monkeypatch.setattr(loop, "SAVE_EVERY", 0.0)
    monkeypatch.setattr(loop, "COLLAPSED", 0.0)  # a few steps find nothing


def kill_at(monkeypatch, stage, step):
    """Raise in the middle of a stage, before the batch of `step` is drawn."""
    kind = type(TINY.stages[stage])
    draw, calls = kind.draw, []

    def dying(self, context, data, rng):
        calls.append(1)
        if len(calls) > step:
            raise Killed
        return draw(self, context, data, rng)

    monkeypatch.setattr(kind, "draw", dying)


def log_of(folder):
    entries = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [{key: value for key, value in entry.items() if key != "seconds"} for entry in entries]


def assert_same(first, second):
    first, second = flatten(first), flatten(second)
    assert first.keys() == second.keys()
    for key in first:
        np.testing.assert_array_equal(first[key], second[key], err_msg=key)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory, quick_start, unoptimised):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "LOG_EVERY", 1)
        patch.setattr(loop, "COLLAPSED", 0.0)
        return train(dataset(), CONFIG, tmp_path_factory.mktemp("run") / "whole", TINY, seed=3)


CHILD = """
import os, signal, sys
sys.path.insert(0, {here!r})
from pathlib import Path
from keycld_model.training import loop
from swinging import CONFIG, dataset
from test_training import Parts, TINY, initial
Parts.initial = initial
loop.LOG_EVERY, loop.SAVE_EVERY, loop.COLLAPSED = 1, 0.0, 0.0
draw = type(TINY.stages[0]).draw
def dying(self, context, data, rng):
    if Path({out!r}, "state", "weights.safetensors").exists() and len(Path({out!r}, "log.jsonl").read_text()) > 600:
        os.kill(os.getpid(), signal.SIGKILL)
    return draw(self, context, data, rng)
type(TINY.stages[0]).draw = dying
loop.train(dataset(), CONFIG, {out!r}, TINY, seed=3)
"""


@pytest.mark.long
def test_a_run_that_is_killed_again_and_again_ends_with_the_same_weights(uninterrupted, tmp_path):
    out = tmp_path / "killed"
    code = CHILD.format(here=str(Path(__file__).parent), out=str(out))
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert 0 < read_checkpoint(out / "state")[1]["done"] < TINY.stages[0].steps
    with open(out / "log.jsonl", "a") as file:
        file.write('{"step": 4, "stage": "disc')  # a line that was being written
    for stage in (1, 3):
        with pytest.MonkeyPatch.context() as patch:
            kill_at(patch, stage, 2)
            with pytest.raises(Killed):
                train(dataset(), CONFIG, out, TINY, seed=3)
        assert read_checkpoint(out / "state")[1]["stage"] == stage
    result = train(dataset(), CONFIG, out, TINY, seed=3)
    assert_same(result.model.parameters, uninterrupted.model.parameters)
    assert result.validation_vpt == uninterrupted.validation_vpt
    assert log_of(out) == log_of(uninterrupted.folder)
    assert_same(
        read_checkpoint(out / "state")[0]["variables"], read_checkpoint(uninterrupted.folder / "state")[0]["variables"]
    )


@pytest.mark.long
def test_stages_that_are_not_needed_change_nothing(uninterrupted, tmp_path, monkeypatch):
    monkeypatch.setattr(relocate, "spare_keypoint", lambda *_: None)
    more = (
        relocate.Relocate(steps=2, batch=4, learning_rate=1.0),
        relocate.Rediscover(steps=2, batch=4, learning_rate=1.0),
    )
    preset = replace(TINY, stages=(TINY.stages[0], *more, *TINY.stages[1:]))
    result = train(dataset(), CONFIG, tmp_path, preset, seed=3)
    assert_same(result.model.parameters, uninterrupted.model.parameters)
    assert {line["stage"] for line in log_of(tmp_path)} == {stage.name for stage in TINY.stages}


WRITER = """
import sys
from keycld_envs.files import one_writer
with one_writer(sys.argv[1]):
    print(flush=True)
    input()
"""


def test_one_process_at_a_time_trains_into_a_folder(tmp_path):
    command = [sys.executable, "-c", WRITER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline()
        with pytest.raises(InputError, match=r"is being written to by another process"):
            train(dataset(), CONFIG, tmp_path, SHORT)
        other.kill()
    with one_writer(tmp_path):  # a process that is killed leaves no lock
        assert not (tmp_path / "weights.safetensors").exists()


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{"stage": 99}, {"stage": None}, {"stage": -1}, {"done": 99}, {"done": 0.5}])
def test_a_state_that_no_run_leaves_is_refused(uninterrupted, tmp_path, changes):
    tensors, meta = read_checkpoint(uninterrupted.folder / "state")
    write_checkpoint(tmp_path / "state", tensors, {k: v for k, v in {**meta, **changes}.items() if k != "sha256"})
    with pytest.raises(InputError, match=r"state is at step .* remove the folder"):
        train(dataset(), CONFIG, tmp_path, TINY, seed=3)


@pytest.mark.slow
def test_a_finished_run(uninterrupted):
    folder = uninterrupted.folder
    assert uninterrupted.steps == TINY.steps == 18
    loaded = WorldModel.load(folder)
    assert_same(loaded.parameters, uninterrupted.model.parameters)
    meta = loaded.meta or {}
    assert meta["seed"] == 3 and meta["steps"] == 18 and meta["preset"] == "custom"
    assert meta["data"]["sha256"] == dataset().sha256
    training = dataset().split(0.1)[0].sequences().frames / 255.0
    assert meta["epsilon"] == pytest.approx(np.mean((training - training.mean((0, 1))) ** 2), rel=1e-5)
    log = log_of(folder)
    assert [entry["step"] for entry in log if "loss" in entry] == list(range(1, 19))
    scores = [entry for entry in log if "validation_vpt" in entry]
    assert [(s["step"], s["stage"]) for s in scores] == [(6, "discover"), (10, "fit"), (14, "fit"), (18, "distil")]
    for line in (folder / "log.jsonl").read_text().splitlines():
        json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))

    before = (folder / "weights.safetensors").read_bytes()
    again = train(dataset(), CONFIG, folder, TINY, seed=3)  # nothing is left to do
    assert_same(again.model.parameters, uninterrupted.model.parameters)
    assert len(before) > 1000 and len(log_of(folder)) == len(log)


@pytest.mark.slow
def test_the_seed_decides(tmp_path):
    first, second, other = (train(dataset(), CONFIG, tmp_path / str(i), SHORT, seed=s) for i, s in enumerate((0, 0, 1)))
    assert_same(first.model.parameters, second.model.parameters)
    name = "renderer/hourglass/out/kernel"
    assert not np.array_equal(flatten(first.model.parameters)[name], flatten(other.model.parameters)[name])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"seed": 4}, "seed"),
        ({"preset": replace(TINY, stages=(Discover(steps=7, batch=4, learning_rate=1e-3),))}, "stages"),
        ({"preset": replace(TINY, length=9)}, "length"),
        ({"dataset": dataset(count=9)}, "data"),
        ({"config": replace(CONFIG, networks=replace(NETWORKS, hidden=9))}, "config"),
        ({"validation": 0.3}, "validation"),
    ],
)
def test_a_run_is_not_continued_with_other_settings(uninterrupted, change, word):
    settings = {"dataset": dataset(), "config": CONFIG, "preset": TINY, "seed": 3, "out": uninterrupted.folder}
    with pytest.raises(InputError, match=rf"another {word}.*--out"):
        train(**(settings | change))


def test_settings_that_cannot_be_used(tmp_path):
    def refused(words, **change):
        settings = {"dataset": dataset(), "config": CONFIG, "preset": SHORT, "out": tmp_path / "out"}
        with pytest.raises(InputError, match=words):
            train(**(settings | change))
        assert not (tmp_path / "out").exists()

    refused("default, quick, nc, node2", preset="papr")
    refused("seed", seed=-1)
    refused("validation", validation=1.5)
    refused("validation", validation=float("nan"))
    refused("16x16 pixels", config=replace(CONFIG, image_shape=(32, 32)))
    refused("actions", config=replace(CONFIG, mechanism=replace(MECHANISM, num_actions=2)))
    refused("0.02 s", config=replace(CONFIG, timestep=0.01))
    refused("7 frames", dataset=dataset(length=7))
    refused("one recording", dataset=dataset(count=1))
    pictures = replace(NETWORKS, rigid_parts=True)
    refused("no stage Align.*rigid_parts to False", config=replace(CONFIG, networks=pictures))
    refused(
        "a stage Align.*rigid_parts to True",
        preset=replace(SHORT, stages=(Align(steps=1, batch=1, learning_rate=1e-3),)),
    )
    drawn = Distil(steps=1, batch=1, learning_rate=1e-3, composed=2)
    refused("composed frames, but no stage Align.*composed to 0", preset=replace(SHORT, stages=(drawn,)))
    (tmp_path / "file").write_text("")
    refused("file", out=tmp_path / "file")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "report.html").write_text("mine")
    refused("mine exists and was not made by a training", out=tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["report.html"]


@pytest.mark.slow
def test_a_loss_that_is_not_finite_leaves_the_saved_state_intact(tmp_path, monkeypatch):
    wild = replace(SHORT, stages=(Discover(steps=12, batch=4, learning_rate=1e6, one_cycle=False, clip=None),))
    explode = loop.make_step

    def make_step(parts, stage, optimiser, devices=None):
        step, count = explode(parts, stage, optimiser), []

        def stepping(trained, frozen, state, batch):
            count.append(1)
            trained, state, metrics = step(trained, frozen, state, batch)
            if len(count) == 3:  # a finite loss whose gradient is not
                trained = jax.tree.map(lambda a: a * jnp.nan, trained)
            return trained, state, metrics

        return stepping

    monkeypatch.setattr(loop, "make_step", make_step)
    with pytest.raises(TrainingError, match=r"finite.*step 3 of 12.*learning rate of 15625 "):
        train(dataset(), CONFIG, tmp_path, wild)
    tensors, meta = read_checkpoint(tmp_path / "state")
    assert meta["done"] == 2
    assert all(np.isfinite(leaf).all() for leaf in flatten(tensors["variables"]).values())
    assert all(np.isfinite(entry["loss"]) for entry in log_of(tmp_path) if "loss" in entry)


@pytest.mark.long
def test_a_stage_that_turns_non_finite_begins_anew_with_smaller_steps(tmp_path, monkeypatch):
    explode, rates = loop.make_step, []

    def make_step(parts, stage, optimiser, devices=None):
        rates.append(stage.learning_rate)
        step = explode(parts, stage, optimiser)

        def stepping(trained, frozen, state, batch):
            trained, state, metrics = step(trained, frozen, state, batch)
            if len(rates) == 2 and int(state[-1][-1].count) == 3:  # in the second stage, the first time
                trained = jax.tree.map(lambda a: a * jnp.nan, trained)
            return trained, state, metrics

        return stepping

    monkeypatch.setattr(loop, "make_step", make_step)
    two = replace(TINY, stages=(*SHORT.stages, replace(SHORT.stages[0], name="again", steps=4)))
    train(dataset(), CONFIG, tmp_path / "once", two)
    assert rates == [1e-3, 1e-3, 0.25e-3]
    entries = [e for e in log_of(tmp_path / "once") if e["stage"] == "again" and "loss" in e]
    assert [e["step"] for e in entries] == [7, 8, 9, 10]
    smaller = replace(two, stages=(two.stages[0], replace(two.stages[1], learning_rate=0.25e-3)))
    monkeypatch.setattr(loop, "make_step", explode)
    train(dataset(), CONFIG, tmp_path / "small", smaller)
    expected = [e["loss"] for e in log_of(tmp_path / "small") if e["stage"] == "again" and "loss" in e]
    assert [e["loss"] for e in entries] == expected  # nothing of the first attempt is left


@pytest.mark.slow
def test_collapsed_keypoints_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "COLLAPSED", 0.01)
    still = [replace(r, frames=np.full((12, SIZE, SIZE, 3), 99, np.uint8)) for r in recordings()]
    with pytest.raises(TrainingError, match=r"Keypoint 0 has collapsed.*discover"):
        train(replace(dataset(), recordings=tuple(still)), CONFIG, tmp_path, SHORT)


@pytest.mark.slow
def test_the_papers_loss_is_equations_10_to_13():
    config = replace(CONFIG, networks=replace(PAPER_NETWORKS, width=8, groups=4, hidden=8))
    parts, data = Parts(config), TrainingData.from_dataset(dataset(count=3))
    parameters = random_parameters(config)
    stage = PRESETS["paper"].stages[0]
    assert isinstance(stage, Joint)
    assert (stage.steps, stage.batch, stage.learning_rate, stage.dynamics_weight) == (45_000, 1, 3e-4, 5e-4)
    batch = stage.draw({}, data, np.random.default_rng(0))
    assert batch["frames"].shape == (1, 12, SIZE, SIZE, 3)
    loss, gradient = jax.jit(jax.value_and_grad(lambda p: stage.loss(parts, p, batch)[0]))(parameters)

    z, u = batch["frames"][0] / 255.0, batch["actions"][0]
    x = np.asarray(parts.keypoints(parameters, batch["frames"][0]), np.float64)
    drawn = np.asarray(parts.render(parameters, jnp.asarray(x, jnp.float32)))
    total = np.sum((drawn - z) ** 2) / 12
    dynamics = parts.dynamics(parameters)
    acceleration = jax.jit(dynamics.acceleration)
    for n in range(2, 10):
        measured = (x[n + 2] - 2 * x[n] + x[n - 2]) / (4 * TIMESTEP**2)
        velocity = (x[n + 1] - x[n - 1]) / (2 * TIMESTEP)
        model = acceleration(jnp.asarray(x[n], jnp.float32), jnp.asarray(velocity, jnp.float32), u[n])
        total += 5e-4 * np.sum((measured - model) ** 2) / 12
    assert float(loss) == pytest.approx(float(total), rel=1e-3)

    # The fixed pivot is declared, not learned.
    np.testing.assert_array_equal(gradient["dynamics"]["pivot"], 0)
    assert np.abs(gradient["dynamics"]["potential"]["out"]["kernel"]).max() > 0


@pytest.mark.slow
def test_the_papers_preset_trains_and_one_quiet_sequence_is_no_collapse(tmp_path, monkeypatch):
    paper = PRESETS["paper"]
    assert paper.networks == PAPER_NETWORKS
    small = replace(PAPER_NETWORKS, width=8, groups=4, hidden=8)
    preset = replace(paper, networks=small, stages=(replace(paper.stages[0], steps=2),))
    monkeypatch.setattr(loop, "COLLAPSED", 1e-4)  # the spread within a sequence, which is all that a step sees, is 0
    calm = [replace(r, frames=np.repeat(r.load_frames()[:1], 12, axis=0)) for r in recordings()]
    data = replace(dataset(), recordings=tuple(calm))
    result = train(data, replace(CONFIG, networks=small), tmp_path, preset)
    assert [entry["stage"] for entry in log_of(tmp_path)] == ["joint"] * 3
    keypoints = result.model.keypoints(data.split()[0].sequences().frames)
    np.testing.assert_allclose(result.model.level, np.mean(np.sum(keypoints[..., 0, :] ** 2, -1) / 2), rtol=1e-4)


def test_sequences_are_cut_to_length():
    data = TrainingData.from_dataset(dataset(count=2, length=25), 12)
    sequences = dataset(count=2, length=25).sequences()
    assert data.frames.shape == (4, 12, SIZE, SIZE, 3)
    assert data.actions.shape == (4, 11, 1)
    np.testing.assert_array_equal(data.frames[3], sequences.frames[1, 12:24])
    np.testing.assert_allclose(data.actions[3], sequences.actions[1, 12:23])
    np.testing.assert_allclose(data.mean_frame, data.frames.mean((0, 1)) / 255, atol=1e-6)


@pytest.mark.slow
def test_the_keypoint_table_follows_the_estimator():
    parts, data = Parts(CONFIG), TrainingData.from_dataset(dataset(count=3))
    first, second = random_parameters(CONFIG, 0), random_parameters(CONFIG, 1)
    for parameters in (first, second, first):
        table = keypoint_table(parts, parameters, data)
        direct = parts.keypoints(parameters, jnp.asarray(data.flat_frames)).reshape(3, 12, 2)
        np.testing.assert_allclose(table, direct, atol=1e-5)


def test_local_polynomials_are_exact_for_cubics():
    t = TIMESTEP * np.arange(12)
    cubic = (1 + 2 * t - 30 * t**2 + 100 * t**3).astype(np.float32)
    x, v = local_polynomials(cubic[None, :, None], TIMESTEP)
    np.testing.assert_allclose(x[0, :, 0], cubic, atol=1e-5)
    np.testing.assert_allclose(v[0, :, 0], 2 - 60 * t + 300 * t**2, atol=1e-3)


def test_keypoints_slide_along_rods_with_all_that_hangs_on_them():
    from keycld_envs import get_system

    acrobot = get_system("acrobot").mechanism
    assert sliding_rods(acrobot) == end_rods(acrobot) == [(0, 1)]
    assert sliding_rods(MECHANISM) == end_rods(MECHANISM) == []
    x = jnp.array([[0.1, 0.2, 0.5, 0.5]])
    scale = jnp.array([5.0, np.log(2.0)])
    moved = slide_along_rods(acrobot, scale, x)
    np.testing.assert_allclose(moved, [[0.1, 0.2, 0.9, 0.8]], rtol=1e-5)
    np.testing.assert_allclose(slide_along_rods(acrobot, -scale, moved), x, rtol=1e-5)
    chain = Mechanism(4, 1, rods=(Rod(1, 2), Rod(None, 0), Rod(0, 1), Rod(2, 3)))
    assert sliding_rods(chain) == [(0, 1), (1, 2), (2, 3)]
    x = jnp.array([0.0, 0.1, 0.1, 0.1, 0.1, 0.3, 0.4, 0.3])
    scale = jnp.log(jnp.array([3.0, 2.0, 1.0, 0.5]))
    moved = slide_along_rods(chain, scale, x)
    np.testing.assert_allclose(moved, [0.0, 0.1, 0.2, 0.1, 0.2, 0.3, 0.35, 0.3], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(slide_along_rods(chain, -scale, moved), x, rtol=1e-5, atol=1e-7)


def test_keypoints_lean_along_rails_with_all_that_hangs_on_them():
    cart = Mechanism(3, 1, rods=(Rod(1, 0), Rod(0, 2)), sliders=(Slider(1, (0.6, 0.8)),))
    assert rails(cart) == [(1, 0)] and rails(MECHANISM) == []
    x = np.array([0.5, 0.1, 0.2, 0.0, 0.9, 0.3], np.float32)
    along = np.array([0.8, -0.6])
    moved = lean_along_rails(cart, jnp.array([9.0, 0.1, 9.0]), jnp.asarray(x)).reshape(3, 2)
    np.testing.assert_allclose(
        moved - x.reshape(3, 2), np.tile(0.1 * (0.3 * 0.8 - 0.1 * 0.6) * along, (3, 1)), atol=1e-6
    )
    places = {"rod_scale": jnp.array([0.0, 0.0, 0.3]), "lean": jnp.array([0.0, 0.1, 0.0])}
    np.testing.assert_allclose(to_keypoints(cart, places, to_masses(cart, places, jnp.asarray(x))), x, atol=1e-6)


@pytest.mark.slow
def test_recordings_on_the_disk(tmp_path):
    for recording in recordings(4):
        write_recording(tmp_path / "data" / recording.id, recording)
    result = train(read_dataset(tmp_path / "data"), CONFIG, tmp_path / "out", SHORT)
    assert (tmp_path / "out" / "checkpoint.json").is_file()
    assert result.folder == tmp_path / "out"
