"""Uncertainties: stored, turned into intervals and samples as formulas say; and whether they hold what is true."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors.numpy import load_file
from swinging import CONFIG, random_parameters

from keycld_control.benchmarks.intervals.coverage import compare
from keycld_control.benchmarks.intervals.keypoints import Errors, near_truth, simulate
from keycld_control.benchmarks.intervals.mechanisms import KINDS, drawn_mechanism
from keycld_control.benchmarks.intervals.truth import truth_of
from keycld_control.cli import main
from keycld_envs import InputError, get_system
from keycld_envs.mechanism import Mechanism, Rod
from keycld_envs.recordings import Recording, read_dataset, write_recording
from keycld_model import WorldModel
from keycld_model.modules import Parts
from keycld_model.training import covariance
from keycld_model.training.covariance import measure_uncertainty
from keycld_model.uncertainty import Uncertainty, numbers_of

pytestmark = pytest.mark.usefixtures("unoptimised")
ARM = replace(CONFIG, mechanism=Mechanism(num_keypoints=2, num_actions=2, rods=(Rod(None, 0), Rod(0, 1))))


def known(config=ARM, spread=0.0, **deviations):
    """A model whose numbers deviate by what is named, `[r, ...]` each."""
    return of_numbers(WorldModel(config, jax.tree.map(jnp.asarray, random_parameters(config))), spread, **deviations)


def of_numbers(model, spread, **deviations):
    """A model with uncertainties around its own numbers."""
    parameters = model.parameters
    centre = jax.tree.map(np.asarray, numbers_of(parameters, None, None))
    count = max((len(d) for d in deviations.values()), default=1)
    rows = {name: np.zeros((count, *value.shape), np.float32) for name, value in centre.items()}
    rows |= {name: np.asarray(value, np.float32) for name, value in deviations.items()}
    return replace(model, uncertainty=Uncertainty(centre, rows, spread, 0.5))


def middle(interval):
    return interval.mean(axis=-1)


def half(interval):
    return (interval[..., 1] - interval[..., 0]) / 2


def test_intervals_are_those_of_first_order():
    model = known(log_masses=[[0.02, -0.02], [0.03, -0.03]], level=[[0.0, 0.0], [0.004, 0.0]])
    found, (first, second) = model.intervals(), model.masses
    deviation = 1.645 * np.hypot(0.04, 0.06) * first * second  # of a softmax
    np.testing.assert_allclose(half(found.masses), [deviation, deviation], rtol=0.01)
    np.testing.assert_allclose(middle(found.masses), model.masses, atol=1e-6)
    lengths = np.sqrt(2 * model.level)
    np.testing.assert_allclose(half(found.lengths), [1.645 * 0.004 / lengths[0], 0], rtol=0.01, atol=1e-6)
    assert found.potential_energy is None


def test_shares_and_lengths_end_where_there_are_no_others():
    found = known(log_masses=[[2.0, -2.0]], level=[[9.0, 0.0]]).intervals()
    assert found.masses.min() == 0 and found.masses.max() == 1
    assert found.lengths.min() == 0 and found.lengths.max() > 1


def test_what_acts_along_a_rod_is_in_no_interval_and_energies_count_from_the_first_position():
    x = np.array([[[0.0, 0.5], [0.0, 1.0]], [[0.5, 0.0], [1.0, 0.0]]], np.float32)
    along = np.zeros((1, 4, 2))
    along[0, 3] = (
        1.0  # a motor pushes the second keypoint up, along both rods in the first position, across in the other
    )
    model = known(potential=0.01 * np.eye(4)[3].reshape(1, 4, 1), constant_input=along.reshape(1, -1))
    found = model.intervals(at=x)
    scale = model.config.networks.force_scale
    np.testing.assert_allclose(half(found.potential_energy), [0, 1.645 * scale * 0.01], rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(middle(found.potential_energy)[1], np.diff(model.potential_energy(x))[0], rtol=1e-4)
    np.testing.assert_allclose(half(found.input_matrix)[0], 0, atol=1e-4)
    assert half(found.input_matrix)[1, 3].min() > 0.5


def test_samples_are_as_far_apart_as_the_numbers_may_be_off():
    uncertainty = known(level=[[0.01, 0.0], [0.01, 0.02]], spread=0.003).uncertainty
    assert uncertainty is not None
    level = uncertainty.draw(20_000, np.random.default_rng(0))["level"]
    np.testing.assert_allclose(np.cov(level.T), [[2e-4, 2e-4], [2e-4, 4e-4]], rtol=0.05)
    errors = uncertainty.keypoint_errors((20_000, 3, 2), np.random.default_rng(0))
    assert errors.std() == pytest.approx(0.003, rel=0.02)
    assert np.corrcoef(errors[:, 0].ravel(), errors[:, 2].ravel())[0, 1] == pytest.approx(0.25, abs=0.02)


@pytest.mark.long
def test_a_checkpoint_keeps_uncertainties_and_one_without_says_how_to_get_them(tmp_path):
    model = known(level=[[0.01, 0.0]], spread=0.01)
    again = WorldModel.load(model.save(tmp_path / "model"))
    np.testing.assert_array_equal(again.intervals().lengths, model.intervals().lengths)
    assert again.uncertainty is not None
    assert again.uncertainty.spread == pytest.approx(0.01)
    plain = WorldModel.load(replace(model, uncertainty=None).save(tmp_path / "plain"))
    with pytest.raises(InputError, match="keycld intervals"):
        plain.intervals()
    with pytest.raises(InputError, match="keycld intervals"):
        plain.predict(np.zeros((2, 16, 16, 3), np.uint8), np.zeros((2, 2)), 3, samples=1)
    assert set(load_file(tmp_path / "model" / "weights.safetensors")) > set(
        load_file(tmp_path / "plain" / "weights.safetensors")
    )
    other = known(CONFIG, level=[[0.01]]).uncertainty
    with pytest.raises(InputError, match="another model"):
        WorldModel.load(replace(model, uncertainty=other).save(tmp_path / "other"))


def recorded(folder, system):
    """A data set of three recordings of images in which nothing is, of a pendulum with one motor."""
    clock = np.asarray(CONFIG.timestep * np.arange(12), np.float64)
    for name in "abc":
        recording = Recording(
            id=name,
            source="simulation",
            system=system,
            actuator_names=("torque",),
            units={"action": "N m"},
            camera={"width": CONFIG.image_shape[1], "height": CONFIG.image_shape[0]},
            t_action=clock[:-1],
            action=np.zeros((11, 1)),
            t_frame=clock,
            frames=np.zeros((12, *CONFIG.image_shape, 3), np.uint8),
        )
        write_recording(folder / name, recording)
    return read_dataset(folder)


def test_recordings_that_leave_the_equations_singular(tmp_path, monkeypatch):
    """Nothing differs from what is predicted, whatever the numbers of the model are."""

    def nothing(problem, fit, functions, free):
        p, f = free.shape[1], len(functions.kind)
        zero = np.zeros
        empty = zero((3, p, p)), zero((3, p)), zero((3, p, f)), zero((f, f)), zero((3, f))
        return covariance._Sums(free, functions.kind, functions.nearer, zero((p, p)), *empty, 0.0, 0.0, 0.0)

    monkeypatch.setattr(covariance, "_trajectories", lambda *_: {"x": np.zeros((3, 2)), "v": np.zeros((3, 2))})
    monkeypatch.setattr(covariance, "minimise", lambda problem, fit, *_: (fit, 0.0))
    monkeypatch.setattr(covariance, "_sums", nothing)
    model = WorldModel(CONFIG, jax.tree.map(jnp.asarray, random_parameters(CONFIG)))
    with pytest.raises(InputError, match=r"too little moves in them; use .* recordings in motion"):
        covariance.with_uncertainty(model, recorded(tmp_path / "data", None))


@pytest.mark.parametrize("kind", ["double_pendulum", "cartpole"])
def test_parts_that_look_larger_move_all_that_they_carry(kind):
    truth = truth_of(drawn_mechanism(kind, 0))
    mechanism = truth.system.mechanism
    x = truth.positions(np.random.default_rng(0).uniform(-2, 2, (3, 5, truth.model.nq)))
    functions = covariance._functions(mechanism, np.asarray(mechanism.pivot), x.reshape(3, 5, -1).astype(np.float32))
    amplitudes = functions.nearer.reshape(functions.features.shape[-1], 4, 1)
    shift = np.einsum("nth,hcj->ntcj", functions.features, amplitudes)[..., 0].reshape(3, 5, 2, 2)
    share = 0.004 if kind == "double_pendulum" else 0.015  # of the first rod, or of the way along the rail
    np.testing.assert_allclose(
        shift[:, :, 0], share * (x[:, :, 0] - mechanism.pivot) * [1, kind != "cartpole"], atol=1e-5
    )
    np.testing.assert_allclose(shift[:, :, 1], shift[:, :, 0], atol=1e-5)


def test_intervals_of_another_system_or_in_a_folder_that_is_there(tmp_path, capsys):
    model = WorldModel(
        replace(CONFIG, system="KeyCLD/Pendulum-v0"), jax.tree.map(jnp.asarray, random_parameters(CONFIG))
    )
    with pytest.raises(InputError, match="records KeyCLD/Cartpole-v0; measure on recordings of its own system"):
        covariance.with_uncertainty(model, recorded(tmp_path / "data", "KeyCLD/Cartpole-v0"))
    out = str(tmp_path / "data")
    assert main(["intervals", "pendulum", "--data", out, "--out", out]) == 2
    assert "exists already" in capsys.readouterr().err


def test_positions_of_another_shape():
    with pytest.raises(InputError, match="at has shape"):
        known().intervals(at=np.zeros((2, 2)))


def test_point_masses_have_the_energies_that_mujoco_computes():
    """The numbers of the KeyCLD paper's acrobot and cartpole, from their capsules' moments of inertia."""
    arm, cart = truth_of(get_system("acrobot")), truth_of(get_system("cartpole"))
    assert arm.masses[0] / arm.masses[1] == pytest.approx(0.957, abs=0.0005)
    assert arm.system.landmarks[-1].position[2] == pytest.approx(0.7194, abs=1e-4)
    assert cart.masses[0] / cart.masses[1] == pytest.approx(14.7, abs=0.05)
    assert cart.system.landmarks[-1].position[2] == pytest.approx(0.7139, abs=1e-4)
    for kind in KINDS:
        assert truth_of(drawn_mechanism(kind, 0)).masses.sum() == pytest.approx(1)


def measured(truth, motion, errors, rng, off=0.03, started=False):
    """Intervals of a pendulum beside the truth; initial states are known if it has started."""
    x = truth.positions(motion.qpos)
    seen = errors.draw(truth, x, np.random.default_rng(1))
    keypoints = (x.reshape(seen.shape) + seen).astype(np.float32)
    parts, variables = near_truth(truth, rng, off)
    if started:
        start = x[:, 0, 0].astype(np.float32)
        variables["trajectories"] = {"x": jnp.asarray(start), "v": jnp.zeros_like(start)}
    uncertainty = measure_uncertainty(parts, variables, keypoints, motion.actions.astype(np.float32))
    parameters = {**Parts(parts.config).initial(0), **variables}
    return compare(WorldModel(parts.config, parameters, uncertainty=uncertainty), truth, 0)


def holds_what_is_true(compared):
    """Whether all truths are within four standard deviations."""
    return all(
        (np.abs(middle(compared.intervals[name]) - true) < 4 / 1.645 * half(compared.intervals[name])).all()
        for name, true in compared.truth.items()
    )


@pytest.mark.long
def test_intervals_of_a_pendulum_hold_what_is_true_and_grow_with_the_errors():
    truth = truth_of(drawn_mechanism("pendulum", 1))

    def drawn(errors):
        rng = np.random.default_rng(0)
        return measured(truth, simulate(truth, 20, 30, rng), errors, rng)

    noise, pose = Errors(noise=0.001, offset=0, harmonic=0), Errors(noise=0.001, offset=0, harmonic=0.001)
    little, much, by_pose = (drawn(e) for e in (noise, replace(noise, noise=0.003), pose))
    for compared in (little, much, by_pose):
        assert holds_what_is_true(compared)
    widths = [np.mean(half(c.intervals["V"])) for c in (little, much, by_pose)]
    assert 2 * widths[0] < widths[1] < 5 * widths[0]
    assert widths[2] > 1.5 * widths[0]


@pytest.mark.long
def test_fast_turns_leave_forces_as_they_are():
    """Steps of .02 s, one per frame, brake a rod of 30 rad/s: its motor would look weaker by more than its interval."""
    truth = truth_of(drawn_mechanism("pendulum", 1))
    truth = replace(truth, torques=6 * truth.torques)
    truth.model.actuator_gear[:, 0] *= 6
    rng = np.random.default_rng(0)
    motion = simulate(truth, 20, 50, rng)
    assert np.abs(np.diff(motion.qpos, axis=1)).max() > 30 * 0.02
    assert holds_what_is_true(
        measured(truth, motion, Errors(noise=0.0005, offset=0, harmonic=0), rng, off=0.003, started=True)
    )
