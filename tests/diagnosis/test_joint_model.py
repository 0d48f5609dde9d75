"""A joint model in the place of a simulator: its rig moves as it does, and a diagnosis finds what it lacks."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from plants import recordings

from keycld_control.cli import main
from keycld_envs.effects import (
    EFFECTS,
    AddedInertia,
    CoulombFriction,
    GravityTilt,
    StribeckFriction,
    ViscousFriction,
    edited,
)
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, write_recording
from keycld_model import JointModel, delan
from keycld_model.delan import JointConfig, Motions, Preset, train
from keycld_model.delan.baseline import fit_baseline
from keycld_model.delan.config import Family, Kind, Scales
from keycld_model.delan.correction import scaled, with_friction
from keycld_model.delan.deviation import Deviation
from keycld_model.delan.families import JointDynamics
from keycld_model.delan.rig import Motor, learned_dynamics, rig_of
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.motion import Motion, inverse_dynamics
from keycld_model.diagnosis.inputs.joint_model import simulator_of
from keycld_model.diagnosis.simulation.inertia import apply, inertial_nuisances
from keycld_model.diagnosis.simulation.places import not_asked, places_of
from keycld_model.rigid_body.compiled import CompiledEngine
from keycld_model.rigid_body.effects import AppliedEffects
from keycld_model.rigid_body.engine import Copies

ENERGETIC: list[Family] = ["structured", "black_box", "hamiltonian", "least_squares"]


def joint_model(family: Family = "structured", friction: tuple[str, ...] = (), joints: int = 2) -> JointModel:
    """Hinges and slides in turn, with random weights and inertias that are positive."""
    two = (1.0, 2.0, 0.5, 1.0, 2.0, 1.0, 0.5)[:joints]
    kinds: tuple[Kind, ...] = tuple("slide" if j % 2 else "hinge" for j in range(joints))
    config = JointConfig(
        tuple(f"j{j}" for j in range(joints)),
        kinds,
        Scales((0.1,) * joints, two, two, two, two),
        family,
        6,
        2,
        friction,
    )
    parameters, rng = JointDynamics(config).initial(0), np.random.default_rng(1)
    parameters["equations"] = jax.tree.map(
        lambda x: x + 0.2 * rng.standard_normal(np.shape(x)), parameters["equations"]
    )
    if family == "least_squares":
        parameters["equations"]["coefficients"][[0, 6]] += 20.0
    return JointModel(config, parameters)


def stepped(rig: mujoco.MjModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
    """States after steps `[S, 2 n]` under commands `[S, nu]`, by compiled steps."""
    rig.opt.timestep = h
    engine = CompiledEngine.of(rig, exact_stiction=True)
    assert engine is not None
    one = np.zeros(1, np.int64)
    batch = engine.batch(Copies([rig], [AppliedEffects()], one, one))
    control = np.concatenate([u, np.zeros((len(u), len(q)))], axis=1)[None]
    return engine.run(batch, np.concatenate([q, v])[None], control, np.zeros(1))[0]


@pytest.mark.slow
@pytest.mark.parametrize("family", ENERGETIC)
def test_a_rig_moves_as_the_joint_model_does(family: Family) -> None:
    model = joint_model(family, ("viscous_friction", "quadratic_drag"))
    rig = rig_of(model, [Motor("second", "j1", 2.0), Motor("first", "j0")])
    q, v, u = np.array([0.4, -0.3]), np.array([0.8, -0.5]), np.random.default_rng(0).normal(size=(12, 2))
    tau = np.concatenate([u[:, ::-1] * [1.0, 2.0], np.zeros((1, 2))])
    expected = np.concatenate(model.rollout(q, v, tau, 0.01, substeps=1), axis=1)
    assert stepped(rig, q, v, u, 0.01) == pytest.approx(expected[1:], abs=1e-9)


@pytest.mark.slow
def test_seven_joints_are_stepped() -> None:
    model = joint_model("structured", joints=7)
    q, v, tau = np.linspace(-0.4, 0.4, 7), np.linspace(0.3, -0.3, 7), np.zeros((4, 7))
    expected = np.concatenate(model.rollout(q, v, tau, 0.01, substeps=1), axis=1)
    assert stepped(rig_of(model, []), q, v, np.zeros((3, 0)), 0.01) == pytest.approx(expected[1:], abs=1e-9)


@pytest.mark.slow
def test_stribeck_friction_of_a_joint_model_fades_with_speed() -> None:
    model, _ = with_friction(joint_model(), [StribeckFriction("j0", c=0.2, extra=0.3, vs=0.5)])
    q, v, h = np.array([0.4, -0.3]), np.array([0.6, 0.9]), 1e-4
    after = stepped(rig_of(model, []), q, v, np.zeros((1, 0)), h)[0]
    assert (after[2:] - v) / h == pytest.approx(model.forward_dynamics(q, v, np.zeros(2)), rel=1e-3)


def test_forces_along_a_motion_are_those_of_the_joint_model() -> None:
    model = joint_model("structured", ("viscous_friction",))
    rig = rig_of(model, [])
    q, v, a = np.random.default_rng(0).normal(size=(3, 5, 2))
    assert inverse_dynamics(rig, q, v, a) == pytest.approx(model.inverse_dynamics(q, v, a), abs=1e-9)
    rig = edited(rig, [AddedInertia("j0", i=0.3)])
    values = np.random.default_rng(1).normal(size=len(inertial_nuisances(rig)))
    apply(rig, inertial_nuisances(rig), values)
    friction, off = model.decompose(q, v, a).friction, Deviation(model.config)
    more = jax.vmap(lambda *x: off.inverse_dynamics({"coefficients": values[1:]}, *x))
    expected = np.exp(values[0]) * (model.inverse_dynamics(q, v, a) - friction) + friction + a * [0.3, 0.0]
    with jax.enable_x64(True):
        expected += np.asarray(more(q, v, a))
    assert inverse_dynamics(rig, q, v, a) == pytest.approx(expected, abs=1e-9)


def test_what_is_of_bodies_is_not_asked_of_a_joint_model() -> None:
    rig = rig_of(joint_model(), [Motor("motor", "j0")])
    ordinary = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='j0'/><geom size='.1' pos='0 0 1'/></body></worldbody></mujoco>"
    )
    assert learned_dynamics(ordinary) is None and not not_asked(ordinary)
    for kind in EFFECTS.values():
        assert len(places_of(kind, ordinary)) == len(kind.candidates(ordinary))
    assert not places_of(GravityTilt, rig)
    assert [e.where for e in places_of(CoulombFriction, rig)] == ["j0", "j1"]
    assert "gravity_tilt (world)" in not_asked(rig)
    first, *errors = inertial_nuisances(rig)
    assert first.name == "mass of all_links" and {n.kind for n in errors} == {"own error"}


@pytest.mark.parametrize("family", ENERGETIC)
def test_a_factor_scales_all_but_friction(family: Family) -> None:
    model = joint_model(family, ("viscous_friction",))
    q, v, a = np.random.default_rng(0).normal(size=(3, 5, 2))
    friction = model.decompose(q, v, a).friction
    expected = 1.3 * (model.inverse_dynamics(q, v, a) - friction) + friction
    assert scaled(model, 1.3).inverse_dynamics(q, v, a) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_friction_is_added_to_what_was_learned() -> None:
    model = joint_model("structured", ("coulomb_friction",))
    before = {e.where: e.c for e in model.effects if isinstance(e, CoulombFriction)}
    more, left = with_friction(
        model,
        [CoulombFriction("j0", c=0.5), ViscousFriction("j1", b=0.4), AddedInertia("j0", i=1.0)],
    )
    assert [type(e) for e in left] == [AddedInertia]
    found = {e.key: e for e in more.effects}
    assert [getattr(found[("CoulombFriction", j)], "c") for j in before] == pytest.approx(  # noqa: B009
        [before["j0"] + 0.5, before["j1"]]
    )
    assert [getattr(found[("ViscousFriction", j)], "b") for j in before] == pytest.approx([0.0, 0.4], abs=1e-9)  # noqa: B009
    faded, left = with_friction(more, [StribeckFriction("j0", c=0.1, extra=0.2, vs=0.3)])
    assert not left and "coulomb_friction" not in faded.config.friction
    (stribeck,) = (e for e in faded.effects if e.key == ("StribeckFriction", "j0"))
    assert isinstance(stribeck, StribeckFriction)
    assert (stribeck.c, stribeck.extra, stribeck.vs) == pytest.approx((before["j0"] + 0.6, 0.2, 0.3))
    again = StribeckFriction("j0", c=0.1, extra=0.2, vs=0.9)
    assert with_friction(faded, [again])[1] == [again]


def of_pendulum(**changes: object) -> Recording:
    """A recording of a pendulum with a torque of 2 N m per unit."""
    whole = recordings("pendulum", 0, number=1, seconds=0.5)[0]
    return replace(whole, **({"units": {"action": "2 N m", "qpos": "rad"}} | changes))  # type: ignore[arg-type]


def one_hinge(kind: str = "hinge", family: Family = "structured") -> JointModel:
    """An untrained model of the pendulum's joint."""
    one = (1.0,)
    config = JointConfig(("hinge",), (kind,), Scales((0.0,), one, one, one, one), family, 4, 1)  # type: ignore[arg-type]
    return JointModel(config, JointDynamics(config).initial(0))


def test_recordings_that_do_not_suit_a_joint_model_are_refused() -> None:
    whole = of_pendulum()
    assert simulator_of(one_hinge(), [whole]).actuator("torque").gainprm[0] == 2.0
    assert simulator_of(one_hinge(), [of_pendulum(t_action=None, action=None)]).nu == 0
    with pytest.raises(InputError, match=r"\['hinge'\].*\['j0', 'j1'\]"):
        simulator_of(joint_model(), [whole])
    with pytest.raises(InputError, match="in rad, but the joint model has a slide"):
        simulator_of(one_hinge("slide"), [whole])
    with pytest.raises(InputError, match="'1'; torques"):
        simulator_of(one_hinge(), [of_pendulum(units={"action": "1", "qpos": "rad"})])
    with pytest.raises(InputError, match=r"torque \(1\) in place of torque \(2\)"):
        simulator_of(one_hinge(), [whole, of_pendulum(units={"action": "N m", "qpos": "rad"})])
    with pytest.raises(InputError, match="feed-forward"):
        simulator_of(one_hinge(family="feed_forward"), [whole])


def exact_pendulum() -> Motions:
    """Motions of the pendulum of `keycld_envs` by formula, without friction."""
    inertia, weight, motions = 0.24, 0.36 * 9.81, []
    t = np.asarray(0.02 * np.arange(100), np.float64)
    for run in range(8):
        rng = np.random.default_rng(run)
        f, phase, height = rng.uniform((1, 0, 0.3), (4, 6.3, 1.5), (3, 3)).T
        x = f * t[:, None] + phase
        q, v, a = (
            y.sum(1, keepdims=True) for y in (height * np.sin(x), height * f * np.cos(x), -height * f**2 * np.sin(x))
        )
        zero = np.zeros_like(q)
        motions.append(delan.Motion(f"run {run}", t, q, v, a, inertia * a - weight * np.sin(q), zero, zero))
    return Motions("formula", ("hinge",), ("hinge",), tuple(motions))


def diagnosed(folder: Path, model: Path, friction: float, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict]:
    """Exit code and report of recordings with so much Coulomb friction, by the command line."""

    def force(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return -friction * np.tanh(v / 1e-3)

    for recording in recordings("pendulum", 12, force=force, errors=0.0):
        if not (folder / "data" / recording.id).exists():
            write_recording(folder / "data" / recording.id, replace(recording, units=of_pendulum().units))
    words = ["diagnose", str(folder / "data"), "--model", str(model), "--out", str(folder / "out"), "--json"]
    code = main(words)
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.long
def test_a_learned_pendulum_lacks_the_friction_that_its_recordings_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    learned = tmp_path / "model"
    train(exact_pendulum(), learned, Preset("structured", "for tests", width=8, iterations=40))
    code, report = diagnosed(tmp_path / "without", learned, 0.0, capsys)
    assert (code, report["findings"]) == (0, [])
    code, report = diagnosed(tmp_path / "with", learned, 0.1, capsys)
    assert code == 10
    (finding,) = report["findings"]
    assert (finding["effect"], finding["where"]["name"]) == ("coulomb_friction", "hinge")
    assert finding["parameters"]["c"]["value"] == pytest.approx(0.1, abs=0.005)
    assert "gravity_tilt (world)" in report["details"]["not_asked"]
    corrected = tmp_path / "with" / "out" / "corrected_model"
    assert not (tmp_path / "with" / "out" / "corrected.xml").exists()
    (friction,) = JointModel.load(corrected).effects
    assert isinstance(friction, CoulombFriction) and friction.c == pytest.approx(0.1, abs=0.005)
    code, report = diagnosed(tmp_path / "with", corrected, 0.1, capsys)  # which knows it now
    assert (code, report["findings"]) == (0, [])


@pytest.mark.slow
def test_friction_that_was_learned_is_none_that_a_motion_lacks() -> None:
    data = [
        replace(r, units=of_pendulum().units)
        for r in recordings("pendulum", 12, lambda t, q, v, u: -0.3 * np.tanh(v / 1e-3), errors=0.0, number=3)
    ]
    model = fit_baseline(exact_pendulum())
    for known, lacks in ((model, 0.3), (with_friction(model, [CoulombFriction("hinge", c=0.3)])[0], 0.0)):
        motion = Motion.of(data, simulator_of(known, data), STANDARD)
        basis = np.linalg.qr(motion.states)[0]
        friction, left = (
            x - np.einsum("wri,wsi,ws->wr", basis, basis, x)
            for x in (motion.answer(-np.tanh(motion.v / 0.05)), motion.residual)
        )
        assert np.sum(friction * left) / np.sum(friction**2) == pytest.approx(lacks, abs=0.08)  # zeros are off


def test_one_simulator_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / "data" / "one", of_pendulum())
    one_hinge().save(tmp_path / "model")
    words = ["diagnose", str(tmp_path / "data"), "--model", str(tmp_path / "model")]
    for other in (["--env", "pendulum"], ["--mjcf", "arm.xml"]):
        assert main([*words, *other]) == 2
        assert other[0] in capsys.readouterr().err
    assert main([*words[:-1], str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err
