"""What a joint model leaves in the torques of new logs, learned and added to it."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_model import JointModel
from keycld_model.delan import JointConfig, Preset, presets, read_motions, train
from keycld_model.delan.baseline import fit_baseline
from keycld_model.delan.config import Family, Scales
from keycld_model.delan.correction import scaled
from keycld_model.delan.families import JointDynamics
from keycld_model.delan.measures import score
from keycld_model.delan.residual import Residual
from keycld_model.delan.rig import Motor, learned_dynamics, rig_of

Q, V, A = np.array([0.3, -0.4]), np.array([0.5, 1.1]), np.array([-1.0, 0.4])
SMALL = Preset("structured", "for tests", width=6, iterations=20)
VISCOUS, DRY = "viscous_friction", "coulomb_friction"


def untrained(family: Family, seed: int, friction: tuple[str, ...] = ()) -> JointModel:
    """A model of a hinge and a slide, with random weights."""
    two = (1.0, 2.0)
    config = JointConfig(("a", "b"), ("hinge", "slide"), Scales((0.0, 0.1), two, two, two, two), family, 6, 2, friction)
    parameters, rng = JointDynamics(config).initial(seed), np.random.default_rng(seed)
    parameters = jax.tree.map(lambda x: x + 0.3 * rng.standard_normal(np.shape(x)), parameters)
    return JointModel(config, parameters)


def added(base: JointModel, own: JointModel) -> JointModel:
    """The sum that training makes of both."""
    residual = Residual(base, own.config, base.config.scales)
    with jax.enable_x64(True):
        parameters = jax.tree.map(np.asarray, residual.parameters(own.parameters))
    return JointModel(residual.config, parameters)


@pytest.fixture
def loaded_pendulum(pendulum: Path, tmp_path: Path) -> Path:
    """The same motions with a load at the end: .2 kg m^2, 1.6 N m of weight, and .1 N m s/rad of viscous friction."""
    arrays = dict(np.load(pendulum))
    q, v, a = arrays["qp"], arrays["qv"], arrays["qa"]
    path = tmp_path / "loaded.npz"
    np.savez(path, **{**arrays, "tau": arrays["tau"] + 0.2 * a + 1.6 * np.sin(q) + 0.1 * v})
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    "family", ["hamiltonian", *(pytest.param(f, marks=pytest.mark.long) for f in ("structured", "black_box"))]
)
def test_torques_inertias_energies_and_friction_add(family: Family, tmp_path: Path) -> None:
    base, own = untrained("structured", 1, (VISCOUS, DRY)), untrained(family, 2, (VISCOUS,))
    whole = added(base, own)
    tau = base.inverse_dynamics(Q, V, A) + own.inverse_dynamics(Q, V, A)
    assert whole.inverse_dynamics(Q, V, A) == pytest.approx(tau, rel=1e-12)
    assert whole.forward_dynamics(Q, V, tau) == pytest.approx(A, rel=1e-9)
    assert whole.mass_matrix(Q) == pytest.approx(base.mass_matrix(Q) + own.mass_matrix(Q), rel=1e-12)
    assert whole.energy(Q, V) == pytest.approx(base.energy(Q, V) + own.energy(Q, V), rel=1e-12)
    for part in ("inertial", "coriolis", "gravity", "friction"):
        both = [getattr(model.decompose(Q, V, A), part) for model in (base, own)]
        assert getattr(whole.decompose(Q, V, A), part) == pytest.approx(sum(both), rel=1e-9), part
    assert whole.power(Q, V, A) == pytest.approx(V @ tau, rel=1e-9)
    assert [e.id for e in whole.effects] == [VISCOUS, VISCOUS, DRY, DRY]
    loaded = JointModel.load(whole.save(tmp_path / "whole"))
    assert loaded.config == whole.config
    assert np.array_equal(loaded.inverse_dynamics(Q, V, A), whole.inverse_dynamics(Q, V, A))


@pytest.mark.long
def test_a_sum_is_a_base_and_a_simulator_as_any_other() -> None:
    models = [untrained(family, i) for i, family in enumerate(("structured", "black_box", "structured"))]
    whole = added(added(models[0], models[1]), models[2])
    assert len(whole.config.parts) == 3
    tau = sum(model.inverse_dynamics(Q, V, A) for model in models)
    assert whole.inverse_dynamics(Q, V, A) == pytest.approx(tau, rel=1e-12)
    assert scaled(whole, 1.5).inverse_dynamics(Q, V, A) == pytest.approx(1.5 * tau, rel=1e-12)
    moved = learned_dynamics(rig_of(whole, [Motor("m", "a")]))
    assert moved is not None
    forces = moved.forces(Q[None], V[None], A[None], 1.0, np.zeros(moved.deviations))
    assert forces[0] == pytest.approx(whole.inverse_dynamics(Q, V, A), rel=1e-12)
    with jax.enable_x64(True):
        q, v = jnp.asarray(Q[:, None]), jnp.asarray(V[:, None])
        mass, bias = moved.mass_and_bias(q, v, jnp.ones(1), jnp.zeros((moved.deviations, 1)))
    assert np.asarray(mass)[..., 0] @ A + np.asarray(bias)[:, 0] == pytest.approx(tau, rel=1e-9)


@pytest.mark.parametrize(("first", "second"), [(DRY, "stribeck_friction"), ("stribeck_friction", DRY)])
def test_stribeck_friction_takes_up_coulomb_friction(first: str, second: str) -> None:
    base, own = untrained("structured", 1, (first,)), untrained("structured", 2, (second,))
    whole = added(base, own)
    assert whole.config.friction == ("stribeck_friction",)
    friction = [model.decompose(Q, V, A).friction for model in (base, own)]
    assert whole.decompose(Q, V, A).friction == pytest.approx(sum(friction), rel=1e-12)
    with pytest.raises(InputError, match="stribeck"):
        added(whole, untrained("structured", 3, ("stribeck_friction",)))


def test_accelerations_of_a_network_are_added_to_those_of_the_base() -> None:
    base, own = untrained("structured", 1, (VISCOUS,)), untrained("feed_forward", 2)
    whole = added(base, own)
    assert not whole.conserves
    tau = base.inverse_dynamics(Q, V, A) + own.inverse_dynamics(Q, V, A)
    assert whole.inverse_dynamics(Q, V, A) == pytest.approx(tau, rel=1e-12)
    friction = base.decompose(Q, V, A).friction
    accelerations = base.forward_dynamics(Q, V, tau) + own.forward_dynamics(Q, V, tau - friction)
    assert whole.forward_dynamics(Q, V, tau) == pytest.approx(accelerations, rel=1e-12)
    with pytest.raises(InputError, match="feed-forward"):
        whole.energy(Q, V)
    with pytest.raises(InputError, match="feed-forward"):
        rig_of(whole, [])


@pytest.mark.slow
def test_a_residual_finds_the_load_that_the_base_does_not_know(
    pendulum: Path, loaded_pendulum: Path, tmp_path: Path
) -> None:
    base, motions = fit_baseline(read_motions(pendulum), (VISCOUS, DRY)), read_motions(loaded_pendulum)
    loaded = model_of_the_formula(base)
    train(motions, tmp_path / "more", SMALL, [VISCOUS], residual_of=base)
    model = JointModel.load(tmp_path / "more")
    assert score(model, motions).torque_share < 1e-6 < 1e-2 < score(base, motions).torque_share
    assert model.mass_matrix([0.4]) == pytest.approx(np.array([[0.7]]), rel=1e-3)
    assert model.decompose([0.4], [0.0], [0.0]).gravity == pytest.approx([3.6 * np.sin(0.4)], rel=1e-3)
    assert [getattr(e, n) for e, n in zip(model.effects, "bc", strict=True)] == pytest.approx([0.4, 0.1], rel=1e-2)
    rolled, _ = model.rollout([1.0], [0.0], np.zeros((60, 1)), 0.02)
    exact, _ = loaded.rollout([1.0], [0.0], np.zeros((60, 1)), 0.02)
    unloaded, _ = base.rollout([1.0], [0.0], np.zeros((60, 1)), 0.02)
    assert np.abs(rolled - exact).max() < 0.01 < 0.02 < np.abs(unloaded - exact).max()
    with pytest.raises(InputError, match="another"):
        train(motions, tmp_path / "more", SMALL, [VISCOUS], residual_of=scaled(base, 1.001))
    with pytest.raises(InputError, match="no residual"):
        train(motions, tmp_path / "yet_more", SMALL, residual_of=loaded)


def model_of_the_formula(base: JointModel) -> JointModel:
    """The base with the load, exactly."""
    own = JointConfig(base.config.joints, base.config.kinds, base.config.scales, "least_squares", friction=(VISCOUS,))
    coefficients = np.array([0.1, -1.6, 0.0])  # of v^2, and in the potential of cos q and sin q
    parameters = {"equations": {"coefficients": coefficients}, "friction": {VISCOUS: {"b": np.log([0.1])}}}
    return added(base, JointModel(own, parameters))


@pytest.mark.long
def test_residuals_of_the_command(
    pendulum: Path,
    loaded_pendulum: Path,
    letters: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(presets.PRESETS, "structured", SMALL)
    monkeypatch.setitem(presets.PRESETS, "feed_forward", Preset("feed_forward", "for tests", width=4, iterations=3))
    base = str(fit_baseline(read_motions(pendulum), (VISCOUS, DRY)).save(tmp_path / "base"))
    words = ["delan", "train", str(loaded_pendulum), "--residual-of", base, "--out", str(tmp_path / "more")]
    assert main([*words, "--friction", VISCOUS, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["scores"]["torque"] < 1e-2 * told["base"]["torque"]
    assert told["residual_of"] == base
    assert main([*words, "--friction", VISCOUS]) == 0
    assert "base" in capsys.readouterr().out
    assert main([*words[:-1], str(tmp_path / "network"), "--model", "feed_forward", "--json"]) == 0
    capsys.readouterr()
    network = str(tmp_path / "network")
    for changed, said in (
        ({2: str(letters)}, "joint_2"),
        ({4: str(tmp_path)}, "weights"),
        ({4: network}, "feed-forward"),
        ({6: base}, "--out"),
        ({2: str(pendulum)}, "rounding"),
    ):
        assert main([changed.get(i, word) for i, word in enumerate([*words[:-1], str(tmp_path / "not")])]) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1, error
    assert not (tmp_path / "not" / "weights.safetensors").exists()
