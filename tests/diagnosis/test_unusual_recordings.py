"""Recordings as people have them: without commands, with gaps, on a grid, of one run; and those that are refused."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from plants import problem_of, recordings, windows_of

from keycld_control.cli import main
from keycld_envs.effects import ActuatorGain, Backlash
from keycld_envs.effects.gain_drift import GainDrift
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, write_recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.replay import mean_square, rollout_error
from keycld_model.diagnosis.inputs.checks import check
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.observation.checks import check_positions
from keycld_model.diagnosis.inputs.prepare import ready, split
from keycld_model.diagnosis.simulation.contacts import without_contacts
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.simulation.variant import Variant
from keycld_model.rigid_body.compiled import CompiledEngine

FILTERED = """<mujoco><option timestep="0.01"/><worldbody><body name="rod">
<joint name="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" contype="1"/></body>{}
</worldbody><actuator><general name="motor" joint="hinge" dyntype="filter" dynprm="0.2" gainprm="1"/></actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def runs():
    return recordings("pendulum", 2, number=3, seconds=1.2)


@pytest.fixture(scope="module")
def model():
    return get_system("pendulum").compile()


def without_commands(recording):
    return replace(recording, action=None, t_action=None, actuator_names=(), units={"qpos": "rad"})


def with_gaps(recording, share, seed=0):
    missing = np.random.default_rng(seed).random(recording.qpos.shape) < share
    return replace(recording, qpos=np.where(missing, np.nan, recording.qpos))


@pytest.mark.long
def test_what_has_no_commands_is_passive_and_missing_samples_do_no_harm(model):
    runs = recordings("pendulum", 2, lambda t, q, v, u: -0.1 * v, number=18, seconds=2.0)[::3]
    report = diagnose([with_gaps(without_commands(r), 0.2, seed) for seed, r in enumerate(runs)], model)
    assert [(f.effect, f.where["name"]) for f in report.findings] == [("viscous_friction", "hinge")]
    assert report.findings[0].parameters["b"].value == pytest.approx(0.1, rel=0.1)
    assert report.fit.ceiling is not None


def test_missing_samples_count_neither_as_right_nor_as_wrong(runs, model):
    simulator, (sigma,) = Simulator(model, 0.01), noise(runs, model)
    gaps = [with_gaps(r, 0.4, seed) for seed, r in enumerate(runs)]
    fits = []
    for some in (runs, gaps):
        problem = problem_of(simulator, some, sigma)
        fits.append(minimise(problem, problem.start(), iterations=15))
    assert mean_square(fits[1]) == pytest.approx(mean_square(fits[0]), abs=0.3)
    assert rollout_error(fits[1]) == pytest.approx(rollout_error(fits[0]), rel=0.15)


def noise(runs, model):
    return JointPositions(model).calibrated(runs).noise


def test_noise_is_told_beside_gaps_and_is_no_less_than_rounding(runs, model):
    assert noise([with_gaps(r, 0.3) for r in runs], model) == pytest.approx(1e-3, rel=0.25)
    grid, t = 2 * np.pi / 4096, np.arange(400) * 0.01
    swings = 0.3 * np.exp(-2 * t) * np.cos(6 * t)  # comes to rest between two marks
    still = replace(runs[0], t_state=t, qpos=np.round(swings[:, None] / grid) * grid)
    assert noise([still], model) == pytest.approx(grid / np.sqrt(12), rel=0.2)
    smooth = replace(still, qpos=swings[:, None])
    assert noise([smooth], model) < 1e-5
    with pytest.raises(InputError, match="Joint 0 has no 13 samples"):
        noise([replace(still, t_state=t[:12], qpos=swings[:12, None])], model)


def test_the_clock_of_a_single_recording_goes_on_in_the_part_that_is_held_out(runs):
    late = np.asarray(runs[0].t_state) + 100.0
    whole = replace(runs[0], t_state=late, t_action=late)
    model = get_system("pendulum").compile()
    training, test = split([whole], JointPositions(model), 40)
    k = len(np.asarray(training[0].t_state))
    windows = windows_of(test, model)
    assert windows.begun[0] == pytest.approx(0.01 * k) and windows.start[0] == pytest.approx(100 + 0.01 * k)
    assert np.isfinite(windows.measured).all() and not np.isin(np.asarray(training[0].qpos), windows.measured).any()
    check(test, model, JointPositions(model), 40)


def test_windows_do_not_reach_over_a_pause(runs):
    t = np.asarray(runs[0].t_state).copy()
    t[60:] += 300.0
    windows = windows_of([replace(runs[0], t_state=t)], get_system("pendulum").compile())
    assert len(windows) == 2 and windows.steps < 60


def test_motors_remember_earlier_commands_at_the_start_of_a_window():
    model = mujoco.MjModel.from_xml_string(FILTERED.format(""))
    data, u = mujoco.MjData(model), np.repeat([1.0, -2.0, 0.5, 2.0], 40)
    q, v = np.empty((2, len(u) + 1))
    data.act[:] = u[0]  # the first command has held for long
    for k, command in enumerate(u):
        q[k], v[k], data.ctrl[:] = data.qpos[0], data.qvel[0], command
        mujoco.mj_step(model, data)
    q[-1], v[-1] = data.qpos[0], data.qvel[0]
    recording = replace(
        recordings("pendulum", 0, number=1, seconds=0.5)[0],
        actuator_names=("motor",), t_action=0.01 * np.arange(160), action=u[:, None],
        t_state=0.01 * np.arange(160), qpos=q[:-1, None],
    )  # fmt: skip
    simulator = Simulator(model)
    windows = windows_of([recording], model, simulator.step)
    starts = windows.first
    for _ in range(2):  # the second time from memory
        path, _, _ = simulator.roll(
            [Variant(np.zeros(len(simulator.nuisances)))], np.zeros(1, int), windows,
            q[starts][None, :, None], v[starts][None, :, None],
        )  # fmt: skip
        for w, first in enumerate(starts):
            np.testing.assert_allclose(path[0, w, :40, 0], q[first : first + 40], atol=1e-6)


def test_a_floor_that_nothing_touches_does_not_matter(runs):
    floor = '<geom type="plane" size="1 1 .1" pos="0 0 {}"/>'
    low, high = (mujoco.MjModel.from_xml_string(FILTERED.format(floor.format(z))) for z in (-1, -0.2))
    runs = [replace(r, qpos=np.asarray(r.qpos) - np.pi) for r in runs]
    for rod in (low, high):
        assert CompiledEngine.of(rod) is None
    assert not without_contacts(low, runs, JointPositions(low)).geom_contype.any() and low.geom_contype.all()
    assert without_contacts(high, runs, JointPositions(high)) is high


def test_what_acts_on_the_joint_of_a_motor_needs_one():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='j'/><geom size='.1'/><site name='tip'/></body></worldbody>"
        "<actuator><general name='thrust' site='tip' gear='1 0 0 0 0 0'/><motor name='m' joint='j'/></actuator>"
        "</mujoco>"
    )
    assert [e.where for e in ActuatorGain.candidates(model)] == ["thrust", "m"]
    for kind in (GainDrift, Backlash):
        assert [e.where for e in kind.candidates(model)] == ["m"]


def test_angles_may_be_far_apart_across_a_pause(model):
    t = np.r_[np.arange(20), 70 + np.arange(20)] / 100
    turned = np.r_[np.linspace(0, 1, 20), np.linspace(7, 8, 20)][:, None]
    run = Recording(id="0", source="simulation", t_state=t, qpos=turned, joint_names=("hinge",), units={"qpos": "rad"})
    check_positions(run, model)
    with pytest.raises(InputError, match="jump by 6 rad"):
        check_positions(replace(run, t_state=np.arange(40) / 100), model)


def test_recordings_are_refused_with_the_field_and_the_remedy(runs, model):
    r, t, q = runs[0], np.asarray(runs[0].t_state), np.asarray(runs[0].qpos)
    short = replace(r, t_state=t[:60] / 10, qpos=q[:60])
    acrobot = recordings("acrobot", 0, number=1, seconds=1.0)[0]
    blind = np.array(acrobot.qpos)
    blind[:, 1] = np.nan
    two = get_system("acrobot").compile()
    for bad, where, message in (
        (short, model, r"lasts 0.059 s, of which samples 9 ms apart are used, at least 40"),
        (replace(r, t_state=np.zeros_like(t)), model, "clock that stands still"),
        (replace(r, t_state=1000 * t), model, "sample every 10 s; t_state must be in seconds"),
        (replace(r, t_action=np.asarray(r.t_action) + 1e9), model, "must count from the same time"),
        (replace(r, units={"qpos": "deg", "action": "1"}), model, "'hinge' in 'deg'; convert qpos"),
        (replace(r, qpos=(30 * q) % (2 * np.pi)), model, "angles of 'hinge' that jump by .* unwrap"),
        (replace(r, t_state=t[:3], qpos=q[:3]), model, "has 3 samples; a motion needs at least 4"),
        (replace(acrobot, qpos=blind), two, "more than half of the samples of 'elbow'"),
        (replace(acrobot, actuator_names=acrobot.actuator_names[::-1]), two, "order the columns of action"),
    ):
        with pytest.raises(InputError, match=message):
            check([bad, bad], where, JointPositions(where), 40)
            ready([bad, bad], where, 40)
    with pytest.raises(InputError, match="equals the training recording"):
        diagnose([r, r, r], model)


def test_the_command_line_refuses_before_it_diagnoses(tmp_path, runs, capsys):
    data, file = tmp_path / "data", tmp_path / "report"
    for r in runs:
        write_recording(data / r.id, replace(r, system="KeyCLD/Pendulum-v0"))
    file.write_text("mine")
    assert main(["diagnose", str(data), "--out", str(file)]) == 2
    assert "report cannot be written" in capsys.readouterr().err and file.read_text() == "mine"
    assert main(["diagnose", str(data), "--out", str(file / "below")]) == 2
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "report.html").write_text("mine")
    capsys.readouterr()
    assert main(["diagnose", str(data), "--out", str(tmp_path / "run")]) == 2
    assert "report.html was not written by a diagnosis; choose another folder" in capsys.readouterr().err
    assert (tmp_path / "run" / "report.html").read_text() == "mine"
    assert main(["diagnose", str(data), "--env", "Pendulum", "--mjcf", "arm.xml"]) == 2
    assert "--env and --mjcf; name one" in capsys.readouterr().err
    write_recording(data / "other", replace(runs[0], id="other", system="KeyCLD/Acrobot-v0"))
    assert main(["diagnose", str(data)]) == 2
    assert "field system: the recordings name 2 simulators" in capsys.readouterr().err
