"""`WorldModel` and its checkpoints."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file
from swinging import CONFIG, SIZE, random_parameters, recordings

from keycld_envs.errors import InputError
from keycld_model import WorldModel
from keycld_model.checkpoint import META, WEIGHTS, flatten, read_checkpoint, unflatten, write_checkpoint

pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(scope="module")
def model():
    return WorldModel(CONFIG, random_parameters(CONFIG), "a test", {"seed": 3})


@pytest.fixture
def checkpoint(model, tmp_path):
    return model.save(tmp_path / "model")


def same(a, b):
    a, b = flatten(a), flatten(b)
    assert a.keys() == b.keys()
    for key in a:
        assert a[key].dtype == b[key].dtype, key
        np.testing.assert_array_equal(a[key], b[key])


def test_saving_and_loading_keeps_every_bit(model, checkpoint):
    loaded = WorldModel.load(checkpoint)
    same(loaded.parameters, model.parameters)
    assert loaded.config == model.config
    assert loaded.meta is not None and loaded.meta["seed"] == 3
    assert loaded.meta["versions"]["jax"] == jax.__version__
    assert json.loads((checkpoint / META).read_text()) == loaded.meta
    images = recordings(1)[0].load_frames()
    np.testing.assert_array_equal(loaded.keypoints(images), model.keypoints(images))
    again = loaded.save(checkpoint.parent / "again")
    assert (again / WEIGHTS).read_bytes() == (checkpoint / WEIGHTS).read_bytes()


def test_arrays_of_every_rank_and_type_survive(tmp_path):
    tree = {"a": {"scalar": np.int32(7), "none": np.zeros((0, 3), np.float32)}, "b": np.arange(6.0).reshape(2, 3).T}
    read, meta = read_checkpoint(write_checkpoint(tmp_path, tree, {"x": [1, None, "ä"]}))
    same(read, tree)
    assert read["a"]["scalar"].shape == ()
    assert meta["x"] == [1, None, "ä"]
    same(unflatten(flatten(tree)), tree)


def damage(folder, kind):
    weights = folder / WEIGHTS
    payload = weights.read_bytes()
    tensors = load_file(weights)
    meta = json.loads((folder / META).read_text())

    def rewrite(tensors=tensors, **changes):
        write_checkpoint(folder, unflatten(tensors), {k: v for k, v in meta.items() if k != "sha256"} | changes)

    def changed(value):
        name = next(name for name, array in tensors.items() if array.ndim)
        array = tensors[name].copy()
        array.flat[0] = value
        rewrite({**tensors, name: array})

    match kind:
        case "missing":
            weights.unlink()
        case "cut short":
            weights.write_bytes(payload[:-10])
        case "empty":
            weights.write_bytes(b"")
        case "another file":
            weights.write_text("these are no weights")
        case "no description":
            save_file(tensors, weights)
        case "description is no object":
            save_file(tensors, weights, {"checkpoint": "[]"})
        case "other schema":
            other = meta | {"schema": "keycld.checkpoint/99", "versions": {"keycld": "9.9"}}
            save_file(tensors, weights, {"checkpoint": json.dumps(other)})
        case "other arrays":
            name = next(iter(tensors))
            rewrite({**tensors, name: np.zeros(3, np.float32)})
        case "array missing":
            rewrite(dict(list(tensors.items())[1:]))
        case "another type":
            rewrite({name: array.astype(np.float64) for name, array in tensors.items()})
        case "not a number":
            changed(np.nan)
        case "infinite":
            changed(-np.inf)
        case "far too large":
            changed(3e38)
        case "configuration out of range":
            rewrite(config={**meta["config"], "networks": {**meta["config"]["networks"], "hidden": -8}})
        case "other configuration":
            rewrite(config={**meta["config"], "networks": {}})
        case "no configuration":
            rewrite(config=None)
        case "no model":
            rewrite({"other": np.zeros(1)})


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("missing", "keycld train"),
        ("cut short", "damaged"),
        ("empty", "damaged"),
        ("another file", "damaged"),
        ("no description", "damaged"),
        ("description is no object", "damaged"),
        ("other schema", "9.9"),
        ("other arrays", "arrays"),
        ("array missing", "arrays"),
        ("another type", "arrays"),
        ("not a number", "not finite"),
        ("infinite", "not finite"),
        ("far too large", r"beyond 1e\+06"),
        ("configuration out of range", "hidden is -8"),
        ("other configuration", "missing"),
        ("no configuration", "configuration"),
        ("no model", "not a world model"),
    ],
)
def test_a_checkpoint_that_cannot_be_used_is_named(checkpoint, kind, words):
    damage(checkpoint, kind)
    with pytest.raises(InputError, match=words) as error:
        WorldModel.load(checkpoint)
    assert str(checkpoint) in str(error.value)
    assert "\n" not in str(error.value)


def test_every_flipped_byte_is_noticed(checkpoint):
    weights, rng = checkpoint / WEIGHTS, np.random.default_rng(0)
    whole = weights.read_bytes()
    header = int.from_bytes(whole[:8], "little")
    places = [*range(8), *rng.integers(8, 8 + header, 100), *rng.integers(8 + header, len(whole), 100)]
    for at in places:
        damaged = bytearray(whole)
        damaged[at] ^= int(rng.integers(1, 256))
        weights.write_bytes(damaged)
        with pytest.raises(InputError, match=r"weights\.safetensors"):
            read_checkpoint(checkpoint)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"width": 0}, "width is 0"),
        ({"width": 9}, "width is 9; it must be a multiple of groups, 4"),
        ({"groups": True}, "groups is True"),
        ({"hidden": 10**9}, "hidden is 1000000000"),
        ({"gaussian_widths": (0.1, float("nan"))}, "gaussian_widths is nan"),
        ({"segment_widths": (-0.1,)}, r"segment_widths is -0\.1"),
        ({"force_scale": float("inf")}, "force_scale is inf"),
        ({"saliency": -1.0}, r"saliency is -1\.0"),
        ({"constants": 0}, "constants is 0"),
        ({"motion": "none"}, "motion is 'none'"),
    ],
)
def test_a_configuration_out_of_range_is_refused_by_its_field(changes, words):
    with pytest.raises(InputError, match=words):
        replace(CONFIG.networks, **changes)


def test_frames_and_steps_out_of_range_are_refused_by_their_field():
    for changes, words in (
        ({"timestep": float("nan")}, "timestep is nan"),
        ({"timestep": 0.0}, r"timestep is 0\.0"),
        ({"image_shape": (64, 10**9)}, "image_shape is 1000000000"),
    ):
        with pytest.raises(InputError, match=words):
            replace(CONFIG, **changes)


def test_a_model_that_does_not_exist(tmp_path):
    with pytest.raises(InputError, match="nowhere"):
        WorldModel.load(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"did you mean pendulum\?.*shipped"):
        WorldModel.load("pendelum")
    with pytest.raises(InputError, match=r"KeyCLD/AcrobotStock-v0.*shipped"):
        WorldModel.load("KeyCLD/AcrobotStock-v0")


def test_shipped_models_by_name_and_by_environment(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pendulum").mkdir()  # holds no checkpoint, and so hides none
    for source in ("pendulum", "KeyCLD/Pendulum-v0", "KeyCLD/PendulumFullyActuated-v0"):
        assert WorldModel.load(source).system == "KeyCLD/Pendulum-v0"


def test_a_kill_while_saving_leaves_the_old_checkpoint(model, checkpoint, monkeypatch):
    other = replace(model, parameters=random_parameters(CONFIG, seed=1), meta={"seed": 4})

    def die(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("keycld_envs.files.os.replace", die)
        other.save(checkpoint)
    same(WorldModel.load(checkpoint).parameters, model.parameters)

    # Killed between the two files: the description inside the weights counts.
    description = (checkpoint / META).read_bytes()
    other.save(checkpoint)
    (checkpoint / META).write_bytes(description)
    loaded = WorldModel.load(checkpoint)
    same(loaded.parameters, other.parameters)
    assert loaded.meta is not None and loaded.meta["seed"] == 4


def test_shapes(model):
    images = np.stack([r.load_frames()[:3] for r in recordings(2)])
    keypoints = model.keypoints(images)
    assert keypoints.shape == (2, 3, 1, 2)
    assert model.keypoints(images[0, 0]).shape == (1, 2)
    assert model.keypoints(images[:0]).shape == (0, 3, 1, 2)
    assert model.render(keypoints).shape == (2, 3, SIZE, SIZE, 3)
    assert model.render(keypoints[0, 0]).shape == (SIZE, SIZE, 3)
    assert model.potential_energy(keypoints).shape == (2, 3)
    assert model.potential_energy(keypoints[:0]).shape == (0, 3)
    assert model.input_matrix(keypoints).shape == (2, 3, 2, 1)
    assert model.constraint(keypoints).shape == (2, 3, 1)
    assert model.mass_matrix().shape == (2, 2)
    np.testing.assert_allclose(np.trace(model.mass_matrix()), 2)


@pytest.mark.slow
def test_many_images_are_the_same_as_one_at_a_time(model):
    images = np.random.default_rng(0).integers(0, 256, (70, SIZE, SIZE, 3), np.uint8)  # more than one chunk
    keypoints = model.keypoints(images)
    for i in (0, 63, 64, 69):
        np.testing.assert_allclose(keypoints[i], model.keypoints(images[i]), atol=1e-5)
        np.testing.assert_allclose(
            keypoints[i].ravel(), model.keypoints_fn(images[i].astype(np.float32) / 255), atol=1e-5
        )
    x = keypoints[:3]
    np.testing.assert_allclose(model.render(x)[2], model.render_fn(x[2].ravel()), atol=1e-5)
    np.testing.assert_allclose(model.potential_energy(x)[2], model.potential_energy_fn(x[2].ravel()), rtol=1e-4)
    np.testing.assert_allclose(model.input_matrix(x)[2], model.input_matrix_fn(x[2].ravel()), rtol=1e-3, atol=1e-5)


@pytest.mark.slow
def test_predictions(model):
    recording = recordings(1)[0]
    images, actions = recording.load_frames()[:3], np.asarray(recording.action)
    prediction = model.predict(images, actions, 12)
    assert prediction.frames.shape == (12, SIZE, SIZE, 3)
    assert prediction.keypoints.shape == prediction.velocities.shape == (12, 1, 2)
    assert prediction.frames.min() >= 0 and prediction.frames.max() <= 1
    np.testing.assert_allclose(prediction.frames, model.render(prediction.keypoints), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(prediction.keypoints[:, 0], axis=-1), 0.5, atol=1e-4)
    np.testing.assert_allclose(np.sum(prediction.keypoints * prediction.velocities, (1, 2)), 0, atol=1e-2)
    longer = np.concatenate([actions, np.full((4, 1), 9.0)])  # further actions play no part
    np.testing.assert_array_equal(model.predict(images, longer, 12).keypoints, prediction.keypoints)


GOOD = {"images": np.zeros((3, SIZE, SIZE, 3), np.uint8), "actions": np.zeros((9, 1)), "steps": 10}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"images": np.full((3, SIZE, SIZE, 3), np.nan)}, "NaN"),
        ({"images": np.full((3, SIZE, SIZE, 3), 128.0)}, "0 to 1"),
        ({"images": np.zeros((3, 8, SIZE, 3), np.uint8)}, "images has shape"),
        ({"images": np.zeros((SIZE, SIZE), np.uint8)}, "images has shape"),
        ({"images": np.zeros((1, SIZE, SIZE, 3), np.uint8)}, "at least 2"),
        ({"images": np.zeros((SIZE, SIZE, 3), np.uint8)}, "at least 2"),
        ({"actions": np.zeros((8, 1))}, "actions has shape"),
        ({"actions": np.zeros((9, 2))}, "actions has shape"),
        ({"actions": np.zeros(9)}, "actions has shape"),
        ({"actions": np.where(np.arange(9) == 4, np.nan, 0)[:, None]}, r"actions\[4\]"),
        ({"actions": np.full((9, 1), np.inf)}, r"actions\[0\]"),
        ({"steps": 2}, "steps is 2"),
    ],
)
def test_inputs_that_cannot_be_used(model, change, words):
    with pytest.raises(InputError, match=words):
        model.predict(**(GOOD | change))


@pytest.mark.parametrize(
    ("images", "actions"),
    [
        (np.zeros((2, 3, SIZE, SIZE, 3), np.uint8), np.zeros((2, 5, 2))),
        (np.zeros((2, 3, SIZE, SIZE, 3), np.uint8), np.zeros((1, 5, 1))),
        (np.zeros((2, 3, SIZE, SIZE, 3), np.uint8), np.full((2, 5, 1), np.nan)),
        (np.zeros((2, 3, SIZE, SIZE, 3), np.uint8), np.zeros((2, 1, 1))),
        (np.zeros((3, SIZE, SIZE, 3), np.uint8), np.zeros((2, 5, 1))),
    ],
)
def test_rollouts_of_unfitting_arrays(model, images, actions):
    with pytest.raises(InputError):
        model.rollout(images, actions)


def test_keypoints_of_another_mechanism(model):
    for function in (model.render, model.potential_energy, model.input_matrix, model.constraint):
        with pytest.raises(InputError, match=r"\[\.\.\., 1, 2\]"):
            function(np.zeros((4, 2, 2)))


def test_other_parameters_share_the_compiled_functions(model):
    other = model.with_parameters(random_parameters(CONFIG, seed=5))
    x = np.full((1, 2), 0.4)
    assert not np.allclose(other.potential_energy(x), model.potential_energy(x))
    fresh = WorldModel(CONFIG, other.parameters)
    np.testing.assert_allclose(other.potential_energy(x), fresh.potential_energy(x), rtol=1e-6)
    np.testing.assert_array_equal(other.masses, fresh.masses)
