"""The families of joint models: what their equations must satisfy whatever the weights, and what training finds."""

from functools import partial
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
import pytest

from keycld_envs.effects import EFFECTS
from keycld_envs.errors import InputError
from keycld_model import JointModel
from keycld_model.delan import FRICTIONS, PRESETS, JointConfig, Preset, read_motions, train
from keycld_model.delan.baseline import fit_baseline, verdict
from keycld_model.delan.config import Family, Scales
from keycld_model.delan.correction import scaled
from keycld_model.delan.equations import Hamiltonian, Lagrangian
from keycld_model.delan.families import FAMILIES, JointDynamics
from keycld_model.delan.friction import effects, friction_torque
from keycld_model.delan.least_squares import CUTOFFS, chosen_cutoff
from keycld_model.delan.measures import score

SMALL = Preset("structured", "for tests", width=8, iterations=25)
Q, V, A = np.array([0.3, -0.4, 0.7]), np.array([0.5, 1.1, -0.6]), np.array([-1.0, 0.4, 2.0])
ENERGETIC = [name for name in FAMILIES if name != "feed_forward"]


def untrained(family: Family, friction: tuple[str, ...] = ("viscous_friction",)) -> JointModel:
    """A model of a hinge, a slide and a hinge, with random weights."""
    three = (1.0, 2.0, 0.5)
    friction = () if family == "feed_forward" else friction
    kinds = ("hinge", "slide", "hinge")
    scales = Scales((0.0, 0.1, 0.0), three, three, three, three)
    config = JointConfig(("a", "b", "c"), kinds, scales, family, 8, 2, friction)
    parameters, rng = JointDynamics(config).initial(0), np.random.default_rng(1)
    parameters["equations"] = jax.tree.map(
        lambda x: x + 0.3 * rng.standard_normal(np.shape(x)), parameters["equations"]
    )
    if family == "least_squares":  # whose random inertias would not be positive
        parameters["equations"]["coefficients"][[0, 45, 75]] += 20.0
    return JointModel(config, parameters)


@pytest.mark.parametrize("family", ENERGETIC)
def test_forward_dynamics_undo_inverse_dynamics(family: Family) -> None:
    model = untrained(family)
    tau = model.inverse_dynamics(Q, V, A)
    assert model.forward_dynamics(Q, V, tau) == pytest.approx(A, abs=1e-9)


@pytest.mark.parametrize("family", ENERGETIC)
def test_motors_and_friction_are_all_that_changes_the_energy(family: Family) -> None:
    model = untrained(family)
    friction = model.decompose(Q, V, A).friction
    before, after = (model.energy(Q + s * V + s * s / 2 * A, V + s * A) for s in (-1e-4, 1e-4))
    motors = V @ (model.inverse_dynamics(Q, V, A) - friction)
    assert (after - before) / 2e-4 == pytest.approx(motors, rel=1e-4, abs=1e-5)
    assert model.power(Q, V, A) == pytest.approx(V @ model.inverse_dynamics(Q, V, A), rel=1e-9)


@pytest.mark.parametrize("family", ["structured", "hamiltonian"])
def test_inertias_are_symmetric_and_positive_and_parts_add_up(family: Family) -> None:
    model = untrained(family)
    many = np.random.default_rng(0).standard_normal((50, 3))
    inertias = model.mass_matrix(many)
    assert inertias == pytest.approx(np.swapaxes(inertias, 1, 2), rel=1e-9)
    assert np.linalg.eigvalsh(inertias).min() > 0
    parts = model.decompose(Q, V, A)
    whole = parts.inertial + parts.coriolis + parts.gravity + parts.friction
    assert whole == pytest.approx(model.inverse_dynamics(Q, V, A), rel=1e-9)
    assert parts.inertial == pytest.approx(model.mass_matrix(Q) @ A, rel=1e-9)
    slope = [(model.potential_energy(Q + e) - model.potential_energy(Q - e)) / 2e-5 for e in 1e-5 * np.eye(3)]
    assert parts.gravity == pytest.approx(np.array(slope), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize(("family", "general"), [("structured", Lagrangian), ("hamiltonian", Hamiltonian)])
@pytest.mark.parametrize("joints", [1, 2, 3, 4])
def test_torques_in_one_pass_are_those_of_the_general_equation(family: Family, general: Any, joints: int) -> None:
    sizes, rng = tuple(0.5 + 0.3 * i for i in range(joints)), np.random.default_rng(joints)
    kinds = ("hinge", "slide", "hinge", "hinge")[:joints]
    config = JointConfig(tuple("abcd"[:joints]), kinds, Scales(sizes, sizes, sizes, sizes, sizes), family, 8, 2)
    dynamics = JointDynamics(config)
    p = jax.tree.map(lambda x: x + 0.3 * rng.standard_normal(np.shape(x)), dynamics.initial(0))
    model, state = JointModel(config, p), rng.standard_normal((3, joints))
    with jax.enable_x64(True):
        equation = jax.jit(partial(general.inverse_dynamics, dynamics.equations, p["equations"]))
        q, v, a = state
        tau = np.asarray(equation(q, v, a))
    assert model.inverse_dynamics(q, v, a) == pytest.approx(tau, rel=1e-11, abs=1e-12)
    assert model.forward_dynamics(q, v, tau) == pytest.approx(a, rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("family", FAMILIES)
def test_many_samples_are_as_one_after_another(family: Family) -> None:
    model = untrained(family)
    q = np.stack([Q, V, A]).reshape(3, 1, 3)
    many = model.inverse_dynamics(q, q, q)
    assert many.shape == (3, 1, 3)
    assert many[1, 0] == pytest.approx(model.inverse_dynamics(q[1, 0], q[1, 0], q[1, 0]), rel=1e-12)


@pytest.mark.parametrize("effect", FRICTIONS)
def test_friction_is_that_of_the_effect_in_mujoco(effect: str) -> None:
    model = untrained("structured", (effect,))
    velocities = np.array([2.0, -1.5, 0.7])
    with jax.enable_x64(True):
        ours = np.asarray(friction_torque(model.parameters["friction"], jax.numpy.asarray(velocities)))
    rig = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody>"
        + "".join(f"<body pos='{i} 0 0'><joint name='{name}'/><geom size='.1'/></body>" for i, name in enumerate("abc"))
        + "</worldbody></mujoco>"
    )
    data = mujoco.MjData(rig)
    for found in effects(model.config, model.parameters["friction"]):
        assert type(found) is EFFECTS[effect]
        found.edit(rig)
    data.qvel[:] = velocities
    mujoco.mj_forward(rig, data)
    force = data.qfrc_passive - rig.dof_frictionloss * np.sign(velocities)
    for found in effects(model.config, model.parameters["friction"]):
        if found.has_dry_friction:
            force += found.force(rig, np.zeros(()), data.qpos, data.qvel, np.zeros(0))
    assert ours == pytest.approx(-force, rel=1e-6)


@pytest.mark.slow
def test_baseline_is_exact_on_an_arm_and_finds_friction(letters: Path, pendulum: Path) -> None:
    learned, test = read_motions(letters).hold_out(["e", "f"])
    found = score(fit_baseline(learned), test)
    assert found.torque < 1e-20
    assert found.coriolis is not None and found.coriolis < 1e-20
    motions = read_motions(pendulum)
    baseline = fit_baseline(motions, ("viscous_friction", "coulomb_friction"))
    assert score(baseline, motions).torque < 1e-20
    assert [getattr(e, n) for e, n in zip(baseline.effects, "bc", strict=True)] == pytest.approx([0.3, 0.1])
    assert baseline.mass_matrix([0.4]) == pytest.approx(np.array([[0.5]]))


@pytest.mark.slow
@pytest.mark.parametrize("family", [p.family for p in PRESETS.values()])
def test_training_learns_the_arm(family: Family, letters: Path, tmp_path: Path) -> None:
    rest, test = read_motions(letters).hold_out(["f"])
    model = train(rest, tmp_path / "run", Preset(family, "for tests", width=12, iterations=25)).model
    found, whole = score(model, test), np.mean(np.sum(test.all("tau") ** 2, axis=1))
    share = 0.05 if model.config.family in ENERGETIC else 1.0  # without mechanics, 240 samples say little of others
    assert found.torque < share * whole
    assert found.valid_time > 0
    assert "least squares" in verdict(found, score(fit_baseline(rest), test)).lower()


@pytest.mark.slow
def test_training_finds_friction(pendulum: Path, tmp_path: Path) -> None:
    friction = ("viscous_friction", "coulomb_friction")
    model = train(read_motions(pendulum), tmp_path / "run", SMALL, friction).model
    assert [getattr(e, n) for e, n in zip(model.effects, "bc", strict=True)] == pytest.approx([0.3, 0.1], rel=0.02)


@pytest.mark.slow
def test_a_killed_training_goes_on_to_the_same_weights(
    letters: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from keycld_model.delan import training

    motions, recipe = read_motions(letters), Preset("structured", "for tests", width=6, iterations=8)
    whole = train(motions, tmp_path / "whole", recipe).model
    monkeypatch.setattr(training, "SAVE_EVERY", 0.0)
    append = training.log.append

    def killed(folder: Path, entry: dict) -> None:
        append(folder, entry)
        if entry["step"] == 5:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(training.log, "append", killed)
        with pytest.raises(KeyboardInterrupt):
            train(motions, tmp_path / "parts", recipe)
    parts = train(motions, tmp_path / "parts", recipe)
    assert parts.iterations == 8
    for a, b in zip(jax.tree.leaves(whole.parameters), jax.tree.leaves(parts.model.parameters), strict=True):
        assert np.array_equal(a, b)
    with pytest.raises(InputError, match="another seed"):
        train(motions, tmp_path / "parts", recipe, seed=1)


def test_models_survive_saving_and_refuse_what_does_not_fit(tmp_path: Path) -> None:
    model = untrained("structured", FRICTIONS[:1])
    loaded = JointModel.load(model.save(tmp_path / "arm"))
    assert np.array_equal(loaded.inverse_dynamics(Q, V, A), model.inverse_dynamics(Q, V, A))
    for call in (
        lambda: model.inverse_dynamics(Q[:2], V[:2], A[:2]),
        lambda: model.inverse_dynamics(Q, V[None], A),
        lambda: model.inverse_dynamics(Q, V * np.nan, A),
        lambda: model.rollout(Q, V, A, 0.1),
        lambda: model.rollout(Q, V, A[None], -0.1),
        lambda: untrained("feed_forward").potential_energy(Q),
        lambda: JointModel.load(tmp_path),
        lambda: JointConfig(("a",), ("hinge",), model.config.scales),
    ):
        with pytest.raises(InputError):
            call()


def test_rollouts_follow_a_pendulum(pendulum: Path) -> None:
    model = fit_baseline(read_motions(pendulum), ("viscous_friction", "coulomb_friction"))
    q, v = model.rollout([1.0], [0.0], np.zeros((60, 1)), 0.02)
    x, h = np.array([1.0, 0.0]), 1e-4
    for _ in range(round(59 * 0.02 / h)):
        x[1] += h * (-2.0 * np.sin(x[0]) - 0.3 * x[1] - 0.1 * np.tanh(x[1] / 0.02)) / 0.5
        x[0] += h * x[1]
    assert (q.shape, v.shape) == ((60, 1), (60, 1))
    assert [q[-1, 0], v[-1, 0]] == pytest.approx(x, abs=1e-3)


def test_combinations_that_are_told_too_badly_are_left_out_and_no_others() -> None:
    rng, true = np.random.default_rng(0), np.array([1.0, -2.0, 0.5])
    good = rng.standard_normal((200, 1, 3))
    tau, folds, one = good @ true, np.arange(200) // 20 % 5, np.ones(1)
    tells = np.where(folds[:, None] == np.arange(5), 1.0, 1e-4)[:, None]  # each fold one difference from a column
    alike = np.concatenate([good, good[..., :1] + tells * rng.standard_normal((200, 1, 5))], axis=2)
    noisy = tau + 0.1 * rng.standard_normal((200, 1))
    assert chosen_cutoff(good, tau, one, folds) == CUTOFFS[0]
    assert chosen_cutoff(good, noisy, one, folds) == CUTOFFS[0]
    assert chosen_cutoff(alike, noisy, one, folds) > 1e-5


def test_inertias_that_are_not_positive_are_counted_and_said(pendulum: Path) -> None:
    motions = read_motions(pendulum)
    model = fit_baseline(motions, ("viscous_friction", "coulomb_friction"))
    found = score(model, motions)
    assert found.indefinite == 0.0
    wrong = score(scaled(model, -1.0), motions)
    assert wrong.indefinite == 1.0
    assert "not positive at 100%" in verdict(found, wrong) and "not positive" not in verdict(wrong, found)
