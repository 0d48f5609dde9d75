"""What owners of real recordings identified: their files, their friction, and the servo's law."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keycld_control.benchmarks.real import servo
from keycld_control.benchmarks.real.owners import double_pendulum, multiarm, servo_friction, simple_pendulum
from keycld_control.benchmarks.real.owners.servo_friction import ServoFriction
from keycld_control.benchmarks.real.owners.versus import compare
from keycld_control.benchmarks.real.parameter_files import numbers_of
from keycld_control.benchmarks.real.replay import SIGMA, HeldOutRollouts, Observed, roll
from keycld_control.benchmarks.refitting import JointPositions, Simulator, Variant
from keycld_envs.effects import GearFriction
from keycld_envs.errors import InputError
from keycld_envs.recordings.importers import Columns, Table, assemble
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD

DATA = Path(os.environ.get("KEYCLD_REAL", Path(__file__).parents[2].parent / "shared" / "real"))
KT, OHM, ROTOR = 0.37, 2.8, 0.0018
M6 = {
    "friction_base": 0.005,
    "friction_stribeck": 0.005,
    "load_friction_motor": 0.27,
    "load_friction_external": 0.05,
    "load_friction_external_stribeck": 0.08,
    "load_friction_motor_quad": 0.01,
    "load_friction_external_quad": 0.005,
    "dtheta_stribeck": 2.9,
    "alpha": 2.0,
    "q_offset": 0.0,
}
WEIGHT = servo.MASS * servo.GRAVITY * servo.LENGTH


def m6(motor: float, outside: float, v: float) -> float:
    """The owners' friction, N m, written out."""
    known, fades = M6, np.exp(-(abs(v / M6["dtheta_stribeck"]) ** M6["alpha"]))
    out = known["friction_base"] + abs(known["load_friction_external"] * outside - known["load_friction_motor"] * motor)
    out += fades * (known["friction_stribeck"] + known["load_friction_external_stribeck"] * abs(outside))
    if np.sign(outside) != np.sign(motor) and abs(outside) < abs(motor):
        out += fades * known["load_friction_external_quad"] * outside**2
    elif np.sign(outside) != np.sign(motor):
        out += fades * known["load_friction_motor_quad"] * motor**2
    return out


FRICTIONS = {
    "none": (lambda motor, outside, v: 0.0, ()),
    "gear": (lambda motor, outside, v: 0.3 * abs(motor), (GearFriction("servo", 0.3),)),
    "m6": (m6, (ServoFriction.of(M6),)),
}


def driven(friction, h=1e-4, seconds=1.2, pace=1.0, gain=400):
    """A servo between two angles by its own law, stepped finely; what a log holds."""
    inertia, q, v, rows = servo.MASS * servo.LENGTH**2 + 1e-6 + ROTOR, 0.0, 0.0, []
    for k in range(round(seconds / h)):
        if k % 50 == 0:
            goal = 0.9 * np.sin(4 * pace * k * h) + 0.3 * np.sin(9 * pace * k * h)
            volts = servo.SUPPLY * np.clip(servo.DUTY_PER_ERROR * gain * (goal - q), -1, 1)
            rows.append((k * h, q, goal, volts))
        motor, outside = KT / OHM * (volts - KT * v), -WEIGHT * np.sin(q)
        free = v + h * (motor + outside) / inertia
        after = np.sign(free) * max(0.0, abs(free) - h * friction(motor, outside, v) / inertia)
        q, v = q + h * (v + after) / 2, after
    return np.array(rows)


def recorded(rows, id="servo", noise=0.0):
    """A recording of it; the encoder has noise, rad."""
    t, q, _, volts = rows.T
    q = q + noise * np.random.default_rng(0).normal(size=len(q))
    columns = Columns("t", {"hinge": "q"}, {}, {"servo": "u"}, units={"q": "rad", "u": "V"})
    return assemble(Table(Path("servo"), {"t": t, "q": q, "u": volts}), columns, id)


@pytest.mark.long
def test_friction_in_a_gear_is_named_where_the_servo_rests_half_of_the_time():
    def friction(motor, outside, v):  # and something in no library
        return 0.3 * abs(motor) + 0.01 * np.sin(20 * v) ** 2

    paces = zip((0.3, 0.5, 0.7, 0.9, 1.1, 0.4), (100, 200, 400, 800, 400, 200), strict=True)
    runs = [recorded(driven(friction, seconds=4.0, pace=p, gain=g), f"{i}", 2e-4) for i, (p, g) in enumerate(paces)]
    asked = replace(STANDARD, far_above_noise=1.0)
    report = diagnose(runs, servo.servo(KT, OHM, ROTOR, 0.0), criteria=asked)
    first = report.findings[0]
    assert report.verdict == "mismatch" and report.details["folds"] == len(runs)
    assert (first.effect, first.where["name"]) == ("load_dependent_friction", "servo")
    assert first.parameters["mu"].value == pytest.approx(0.3, rel=0.2)


@pytest.mark.parametrize("name", FRICTIONS)
def test_the_servo_moves_as_its_law_says(name):
    recording = recorded(driven(FRICTIONS[name][0]))
    model = servo.servo(KT, OHM, ROTOR, 0.0)
    simulator = Simulator(model, 0.005)
    rig = Observed(simulator, JointPositions(model, np.full(1, SIGMA)))
    none = np.zeros(len(simulator.nuisances) + len(rig.observation.nuisances))
    errors = {key: roll(rig, Variant(none, own), [recording], 0.5).error() for key, (_, own) in FRICTIONS.items()}
    assert errors[name] < 2.0  # mrad; commands are averaged over the samples
    assert all(error > 4 * errors[name] for key, error in errors.items() if key != name)


def test_a_log_says_the_voltage_and_a_damaged_one_what_is_wrong(tmp_path):
    t, q, goal, volts = driven(FRICTIONS["none"][0], seconds=0.1).T
    names = ("timestamp", "position", "goal_position")
    entries = [dict(zip(names, row, strict=True)) for row in zip(t, q, goal, strict=True)]
    (tmp_path / "log.json").write_text(json.dumps({"kp": 400, "vin": servo.SUPPLY, "entries": entries}))
    np.testing.assert_allclose(servo.read_servo_log(tmp_path / "log.json").columns["volts"], volts)
    (tmp_path / "log.json").write_text(json.dumps({"vin": servo.SUPPLY, "entries": entries}))
    with pytest.raises(InputError, match="has no 'kp'; a log of a servo holds its goal, position, gain and supply"):
        servo.read_servo_log(tmp_path / "log.json")


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("none.json", None, "does not exist"),
        ("cut.json", '{"kt": 0.3', "cannot be read"),
        ("list.json", "[1, 2]", "has no number 'kt'"),
        ("text.yml", "kt: three\n", "has no number 'kt'"),
    ],
)
def test_a_damaged_file_of_parameters_is_one_sentence(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=words) as raised:
        numbers_of(tmp_path / name, ["kt"])
    assert "\n" not in str(raised.value) and name in str(raised.value)


def test_numbers_of_lines(tmp_path):
    (tmp_path / "a.txt").write_text("System:  Pendulum\nJ   = +6.2e-02\ntau = J * a\nm*cx: 0.1\n")
    assert numbers_of(tmp_path / "a.txt", ["J"]) == {"J": 0.062, "m*cx": 0.1}


def test_ratios_are_of_the_same_rollouts():
    rng = np.random.default_rng(0)
    measured, error = rng.normal(size=(6, 5, 1)), rng.normal(size=(6, 5, 1))
    index, time = np.repeat([0, 1, 2], 2), np.zeros((6, 5))
    theirs, ours = (HeldOutRollouts(index, time, measured, measured + size * error) for size in (2e-3, 1e-3))
    found = compare(theirs, ours, 0.5)
    assert (found.ratio, found.low, found.high) == pytest.approx((0.5, 0.5, 0.5))
    assert (found.rollouts, found.recordings) == (6, 3)


@pytest.mark.real
@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} does not exist")
def test_all_published_models_are_read():
    assert [m.name for m in servo_friction.owners_models(DATA)] == list(servo_friction.NAMES)
    for design, names in double_pendulum.MODELS.items():
        assert [m.name for m in double_pendulum.owners_models(DATA, design)] == list(names)
    (simple,), (arm,) = simple_pendulum.owners_models(DATA), multiarm.owners_models(DATA)
    assert [str(e) for e in simple.effects][2] == "constant_force at hinge: tau = f (f=0.07586 N m)"
    assert arm.simulator.body_mass[1] == pytest.approx(0.14775, rel=1e-4)
