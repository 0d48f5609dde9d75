"""Diagnoses of mechanisms whose missing physics is known."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from plants import problem_of, recordings

from keycld_envs import KeyCLDEnv
from keycld_envs.effects import ActuatorDelay, ViscousFriction
from keycld_envs.errors import InputError
from keycld_envs.systems import get_system
from keycld_model.diagnosis import Source, diagnose
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.inputs.checks import check
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.output.words import in_sentence
from keycld_model.diagnosis.search.explain import coarseness
from keycld_model.diagnosis.simulation.simulator import Simulator

ELBOW = np.array([0.0, 1.0])
MISSING = {
    "viscous_friction": ("cartpole", {"force": lambda t, q, v, u: -0.05 * v * ELBOW}, "hinge_1", {"b": 0.05}),
    "coulomb_friction": (
        "acrobot",
        {"force": lambda t, q, v, u: -0.05 * np.tanh(v / 0.01) * ELBOW},
        "elbow",
        {"c": 0.05},
    ),
    "actuator_dead_zone": (
        "acrobot",
        {"command": lambda u: np.where(ELBOW > 0, np.sign(u) * np.maximum(0, np.abs(u) - 0.2), u)},
        "elbow",
        {"delta": 0.2},
    ),
    "cogging": ("pendulum", {"force": lambda t, q, v, u: 0.1 * np.sin(5 * q)}, "hinge", {"a": 0.1, "n": 5.0}),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "system", ["pendulum", *(pytest.param(n, marks=pytest.mark.long) for n in ("cartpole", "acrobot"))]
)
def test_no_alarm_where_only_masses_and_encoder_zeros_are_off(system):
    report = diagnose(recordings(system, seed=1), get_system(system).compile())
    assert (report.verdict, report.findings, report.exit_code) == ("no_mismatch", [], 0)
    assert not report.unexplained.significant
    assert report.fit.refitted < 0.5 * report.fit.nominal


@pytest.mark.long
@pytest.mark.parametrize("effects, verdict", [((), "no_mismatch"), ((ViscousFriction("hinge", b=0.1),), "mismatch")])
def test_a_simulation_is_compared_with_itself_integrator_and_all(effects, verdict):
    """The pendulum's Euler steps of 0.02 s are far from the truth, but they are what both do."""
    env, rng, runs = KeyCLDEnv("pendulum", obs_type="state", effects=effects), np.random.default_rng(0), []
    for run in range(6):
        env.reset(seed=run)
        u, t = np.repeat(rng.uniform(-1, 1, (12, 1)), 15, axis=0), 0.02 * np.arange(180)
        q = np.array([env.step(a)[4]["qpos"] for a in u])
        runs.append(
            replace(
                recordings("pendulum", 0, number=1, seconds=0.5)[0],
                id=f"{run}",
                t_action=t - 0.02,
                action=u,
                t_state=t,
                qpos=q + rng.normal(0, 1e-3, q.shape),
            )
        )
    report = diagnose(runs, KeyCLDEnv("pendulum", obs_type="state").model)
    assert report.verdict == verdict
    assert [f.effect for f in report.findings] == [e.id for e in effects]
    assert report.details["integrator"] == "mjINT_EULER"


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect", [*(pytest.param(e, marks=pytest.mark.long) for e in MISSING if e != "cogging"), "cogging"]
)
def test_one_effect_is_named_placed_and_measured(effect):
    system, missing, place, values = MISSING[effect]
    report = diagnose(recordings(system, seed=2, **missing), get_system(system).compile())
    assert (report.verdict, report.exit_code) == ("mismatch", 10)
    (finding,) = report.findings
    assert (finding.effect, finding.where["name"]) == (effect, place)
    for name, value in values.items():
        assert finding.parameters[name].value == pytest.approx(value, rel=0.05)
    assert report.fit.corrected < 0.5 * report.fit.refitted
    assert place in report.headline and in_sentence(effect) in report.headline
    assert report.evidence is not None
    squares = [np.nanmean((r.measured - r.corrected) ** 2) for r in report.evidence.rollouts]
    assert 1e3 * np.sqrt(np.mean(squares)) == pytest.approx(report.fit.corrected, rel=1e-3)
    assert json.loads(json.dumps(report.to_dict()))["schema"] == "keycld.diagnosis/1"


def test_steps_are_too_coarse_where_commands_jump_within_them():
    runs = recordings("pendulum", 4, number=3, seconds=1.0)
    simulator = Simulator(get_system("pendulum").compile(), 0.01)
    problem = problem_of(simulator, runs, 1e-5)
    start = problem.start()
    fits = [
        Fit(problem, start.with_effects(*effects), 0.0, np.eye(0))
        for effects in ((), (ActuatorDelay("torque", d=0.02),), (ActuatorDelay("torque", d=0.025),))
    ]
    on_the_grid, late_by_steps, within_a_step = (coarseness(fit) for fit in fits)
    assert max(on_the_grid, late_by_steps) < 0.1 * within_a_step and within_a_step > 10


def test_what_has_no_name_in_a_file_gets_one_and_a_model_without_names_is_refused(tmp_path):
    path = tmp_path / "swing.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/><geom size=".1" pos="0 0 -.5" contype="0"/></body>'
        '</worldbody><actuator><motor joint="hinge"/></actuator></mujoco>'
    )
    model = Source.of_file(path).model
    assert (model.body(1).name, model.joint(0).name, model.actuator(0).name) == ("body_1", "hinge", "actuator_0")
    runs = [replace(r, actuator_names=("actuator_0",)) for r in recordings("pendulum", 0, number=2, seconds=0.5)]
    check(runs, model, JointPositions(model), 40)
    with pytest.raises(InputError, match=r"body 1 has no name.*Source\.of_file"):
        diagnose(runs, mujoco.MjModel.from_xml_path(str(path)))


def test_recordings_that_cannot_be_used_are_refused():
    model, good = get_system("pendulum").compile(), recordings("pendulum", 0, number=3, seconds=1.0)
    rest = [replace(r, qpos=np.zeros_like(np.asarray(r.qpos))) for r in good]
    times, positions = np.asarray(good[0].t_state), np.asarray(good[0].qpos)
    for bad, message in (
        ([], "no recordings"),
        (rest, "hinge.*moved 0 rad"),
        ([replace(good[0], joint_names=("knee",))], r"\['knee'\].*\['hinge'\]"),
        ([replace(good[0], t_state=times[:20], qpos=positions[:20])], "20 samples"),
    ):
        with pytest.raises(InputError, match=message):
            diagnose(bad, model)
    with pytest.raises(InputError, match="equals the training recording"):
        diagnose(good[:2], model, held_out=good[1:])
