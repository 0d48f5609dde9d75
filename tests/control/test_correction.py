"""Agents that make up for physics that their model has not learned."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from gymnasium import spaces
from oracle import OracleEnv, image_of, make_oracle, point_masses

from keycld_control.actuation import Actuation
from keycld_control.agent import EnergyShapingAgent
from keycld_control.cli import main
from keycld_control.closed_loop import Loop, run_episode
from keycld_control.correction.concealed import conceal, draw, possible
from keycld_control.correction.corrections import corrections_of
from keycld_control.correction.explore import ASIDE, STEPS, follow
from keycld_control.correction.loop import environment_simulator
from keycld_envs import InputError, get_system, make
from keycld_envs.effects import (
    ActuatorDeadZone,
    ActuatorDelay,
    ActuatorGain,
    ActuatorLag,
    ActuatorSaturation,
    AddedMass,
    CoulombFriction,
    GravityTilt,
)
from keycld_envs.effects.stored import effect_to_json
from keycld_model import WorldModel
from keycld_model.added_effects import added_effects
from keycld_model.diagnosis.verdict.drive import Drive
from keycld_model.physics import PointMasses

LIMIT = 3.0


def exact(name, effects=()):
    """The exact model of a system, with effects."""
    oracle = make_oracle(name)
    if not effects:
        return oracle
    points = PointMasses(oracle.mechanism, oracle.masses, oracle.level, oracle.pivot)
    learned = oracle.potential_energy_fn
    added = added_effects(effects, get_system(name), oracle.timestep, points, learned, oracle.input_matrix_fn)
    return replace(oracle, added=added, potential_energy_fn=lambda x: learned(x) + added.potential_energy(x))


def bounds(size):
    return np.full(size, -LIMIT), np.full(size, LIMIT)


@pytest.mark.parametrize(
    ("effects", "lead", "most"),
    [
        ([], [0, 0], [3.0, 3.0]),
        ([ActuatorGain("slide", 0.5)], [0, 0], [1.5, 3.0]),
        ([ActuatorDelay("slide", 0.03), ActuatorDelay("hinge_1", 0.05)], [3, 5], [3.0, 3.0]),
        ([ActuatorDelay("slide", 0.03), ActuatorGain("slide", 0.4)], [3, 0], [1.2, 3.0]),
        ([ActuatorDeadZone("hinge_1", 0.5)], [0, 0], [3.0, 2.5]),
        ([ActuatorSaturation("hinge_1", 0.7)], [0, 0], [3.0, 0.7]),
    ],
)
def test_motors_do_what_is_wanted_after_their_lead(effects, lead, most):
    added = exact("cartpole", effects).added
    actuation = Actuation(added, *bounds(2))
    np.testing.assert_array_equal(actuation.lead, lead)
    np.testing.assert_allclose(actuation.high, most, atol=1e-6)
    rng = np.random.default_rng(0)
    wanted = rng.uniform(actuation.low, actuation.high, (40, 2))
    commands = np.array([actuation.command(w) for w in wanted])
    assert (np.abs(commands) <= LIMIT + 1e-6).all()
    made = commands if added is None else added.at_motors(np.concatenate([np.zeros((20, 2)), commands]))[20:]
    for i in range(2):
        np.testing.assert_allclose(made[lead[i] :, i], wanted[: 40 - lead[i], i], atol=1e-4)


def test_a_lag_is_made_up_for_within_what_the_motor_can():
    added = exact("cartpole", [ActuatorLag("slide", 0.04)]).added
    actuation = Actuation(added, *bounds(2))
    assert actuation.lead[0] > 0
    commands = np.array([actuation.command(np.array([1.0, 0.0])) for _ in range(60)])
    made = added.at_motors(np.concatenate([np.zeros((1, 2)), commands]))
    assert commands[0, 0] > 1.2  # first too much
    assert made[-1, 0] == pytest.approx(1.0, abs=1e-3)


def test_an_outlook_tells_what_is_under_way():
    actuation = Actuation(exact("cartpole", [ActuatorDelay("slide", 0.02)]).added, *bounds(2))
    for command in ([1.0, 0.1], [2.0, 0.2], [3.0, 0.3]):
        actuation.command(np.array(command))
    outlook = actuation.outlook()
    np.testing.assert_allclose(outlook.applied, [1.0, 0.3], atol=1e-9)
    np.testing.assert_allclose(outlook.queued, [[2.0, 0.3], [3.0, 0.3]], atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "effects"),
    [
        ("cartpole", [CoulombFriction("slider", 0.5), CoulombFriction("hinge_1", 0.3)]),
        ("acrobot", [ActuatorDelay("shoulder", 0.08), ActuatorDelay("elbow", 0.08)]),
        ("acrobot", [ActuatorGain("shoulder", 0.3), CoulombFriction("shoulder", 4.1)]),
        ("pendulum", [ActuatorGain("torque", 0.3), ActuatorDelay("torque", 0.1)]),
    ],
)
def test_told_of_the_effects_an_agent_succeeds_where_it_failed(name, effects):
    env = OracleEnv(name, effects=effects)
    target = image_of(point_masses(name, env.system.target_qpos))
    reached = []
    for known in ([], effects):
        agent = EnergyShapingAgent(exact(name, known), target, action_space=env.action_space)
        reached.append([run_episode(Loop(env, "test", 600, agent), seed).success for seed in range(20_000, 20_002)])
    assert not any(reached[0])
    assert all(reached[1])


@pytest.mark.parametrize("name", ["pendulum", "cartpole", "acrobot"])
def test_draws_are_known_by_seed_and_attempt(name):
    system = get_system(name)
    drawn = [draw(system, 3, attempt) for attempt in range(20)]
    assert drawn == [draw(system, 3, attempt) for attempt in range(20)]
    assert len(set(drawn)) > 15
    assert {len(effects) for effects in drawn} == {1, 2}
    assert any(possible(system, effects) for effects in drawn)


def test_more_friction_than_torque_is_impossible():
    system = get_system("pendulum")
    torque = 3.0 * 2.0
    assert possible(system, [CoulombFriction("hinge", 0.5 * torque)])
    assert not possible(system, [CoulombFriction("hinge", 0.9 * torque)])
    assert not possible(system, [CoulombFriction("hinge", 0.5 * torque), ActuatorGain("torque", 0.5)])
    assert not possible(system, [GravityTilt("world", 1.5), ActuatorGain("torque", 0.8)])


def test_what_does_no_harm_is_passed_over():
    system = get_system("acrobot")
    every = [effects for i in range(10) if possible(system, effects := draw(system, 5, i))]
    effects, passed = conceal(system, 5, lambda effects: effects == every[2])
    assert effects == every[2]
    assert passed == 2
    with pytest.raises(InputError):
        conceal(system, 5, lambda effects: False)


@pytest.mark.parametrize("env_id", ["KeyCLD/Pendulum-v0", "KeyCLD/Acrobot-v0"])
def test_recordings_are_compared_with_a_simulator_whose_motors_do_what_they_are_told(env_id):
    space, simulator = make(env_id).action_space, environment_simulator(env_id)
    assert isinstance(space, spaces.Box)
    assert simulator.actuator_ctrllimited.all()
    np.testing.assert_array_equal(simulator.actuator_ctrlrange, np.stack([space.low, space.high], axis=1))


def test_corrections_are_findings_that_agents_can_make_up_for(tmp_path):
    effects = [CoulombFriction("elbow", 0.4), AddedMass("lower_arm", m=0.1)]
    found, left = corrections_of({"findings": [effect_to_json(effect) for effect in effects]}, "report.json")
    assert found == (effects[0],)
    assert len(left) == 1
    with pytest.raises(InputError):
        corrections_of({"verdict": "mismatch"}, "report.json")


@pytest.mark.parametrize("content", ["{", '{"findings": 3}', '{"findings": [{"effect": "spring"}]}'])
def test_a_report_that_is_none_is_refused(tmp_path, content, capsys):
    path = tmp_path / "report.json"
    path.write_text(content)
    assert main(["swingup", "pendulum", "--corrections", str(path)]) == 2
    assert str(path) in capsys.readouterr().err


@pytest.mark.parametrize(
    "words, named", [(("cartpole", "--workers", "0"), "workers is 0"), (("arm.py",), "no weights")]
)
def test_a_loop_that_cannot_run_leaves_no_folder(words, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "arm"]) == 0
    assert main(["loop", *words, "--conceal", "7", "--out", "loop"]) == 2
    assert named in capsys.readouterr().err
    assert not (tmp_path / "loop").exists()


@pytest.mark.render
def test_a_proposed_experiment_is_recorded_as_it_was_proposed(tmp_path):
    model, weak = WorldModel.load("cartpole"), ActuatorGain("hinge_1", 0.5)
    proposed = {
        "where": {"kind": "actuator", "name": "hinge_1"},
        "action": "drive it with a sine of 2 Hz up to 1",
        "start": {"slider": 0.3, "hinge_1": 3.0},
        "drive": asdict(Drive("sine", 1.0, 2.0)),
    }
    first = follow(tmp_path, "KeyCLD/Cartpole-v0", model, [weak], proposed, 12, seed=5)
    assert [run.id for run in first] == ["episode-00012", "episode-00013", "episode-00014"]
    starts = np.array([np.asarray(run.qpos)[0] for run in first])
    assert np.abs(starts - [0.3, 3.0]).max() < 5 * ASIDE and np.ptp(starts, axis=0).min() > 0
    for run in first:
        action, time = np.asarray(run.action), np.asarray(run.t_action)
        assert action[:, 1] == pytest.approx(np.sin(4 * np.pi * time), abs=1e-6) and not action[:, 0].any()
        assert np.asarray(run.frames).shape[0] == STEPS
    again = follow(tmp_path, "KeyCLD/Cartpole-v0", model, [weak], proposed, 12, seed=5)
    assert all(np.array_equal(np.asarray(a.qpos), np.asarray(b.qpos)) for a, b in zip(first, again, strict=True))
    released = {**proposed, "drive": asdict(Drive())}
    (*_, last) = follow(tmp_path, "KeyCLD/Cartpole-v0", model, [weak], released, 15, seed=5)
    assert last.id == "episode-00017" and not np.any(np.asarray(last.action))


@pytest.mark.long
@pytest.mark.render
def test_the_whole_loop(tmp_path, capsys):
    command = ["loop", "cartpole", "--conceal", "7", "--episodes", "2", "--observe", "states", "--json"]
    assert main([*command, "--out", str(tmp_path)]) == 0
    row = json.loads(capsys.readouterr().out)["rows"][0]
    assert row["after"]["successes"] > row["before"]["successes"]
    assert (tmp_path / "00007" / "corrected" / "weights.safetensors").exists()
    assert main([*command, "--out", str(tmp_path)]) == 0  # nothing is done again
    assert json.loads(capsys.readouterr().out)["rows"][0] == row
    assert main([*command, "--recordings", "9", "--out", str(tmp_path)]) == 2
