"""What gates on real recordings ask of diagnoses, and effects that are concealed in recordings."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from keycld_control.benchmarks.real import ConcealedGate, Gate, dfki, run
from keycld_control.benchmarks.real.concealed import Runs, hidden
from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, Outcome, RecordingFile
from keycld_control.benchmarks.real.gates import r1, r2, r4, r6
from keycld_control.benchmarks.real.replay import SIGMA, Rig, refit, roll
from keycld_control.benchmarks.real.rigs import RigidLink, pendulum
from keycld_control.benchmarks.refitting import JointPositions, Simulator
from keycld_envs.conceal import conceal
from keycld_envs.effects import ViscousFriction
from keycld_envs.errors import InputError
from keycld_envs.recordings.importers import Columns, Table
from keycld_model.diagnosis.verdict.report import Estimate, Finding, FitErrors, Report, Unexplained

PENDULUM = pendulum(RigidLink(1.0, 0.5, 0.3), motor=True)
FRICTION = 0.05
NOMINAL = {f"{what} of link": Estimate(1.0, "1", 0.9, 1.1) for what in ("mass", "length")}


def found(effect: str, where: str, **values: float) -> Finding:
    sizes = {name: Estimate(value, "N m", value, value) for name, value in values.items()}
    return Finding(effect, "dissipation", {"kind": "joint", "name": where}, sizes, "", 1.0, [])


def diagnosed(*findings: Finding, left: bool = False, tables: Sequence[Table] = ()) -> Diagnosed:
    verdict = "mismatch" if findings else "no_mismatch"
    errors, rest = FitErrors("", "mrad", 3.0, 2.0, 1.0), Unexplained(left, 0.1, None, "")
    report = Report(verdict, "", list(findings), NOMINAL, rest, errors, [])
    return Diagnosed(dfki.simulator(), tables, [], [], report, 1.0)


def passes(check: Callable[..., Outcome], *findings: Finding, left: bool = False) -> bool:
    return check({"diagnosis": diagnosed(*findings, left=left)}).passed


def test_r2_asks_for_both_frictions_and_no_viscous_one() -> None:
    shoulder, elbow = (found("coulomb_friction", joint, c=c) for joint, c in r2.FRICTION.items())
    assert passes(r2.check, shoulder, elbow)
    assert not passes(r2.check, shoulder)
    assert not passes(r2.check, shoulder, found("coulomb_friction", "elbow", c=1.2 * r2.FRICTION["elbow"]))
    assert not passes(r2.check, shoulder, elbow, found("viscous_friction", "elbow", b=0.001))
    outcome = r2.check({"diagnosis": diagnosed()})
    assert outcome.reached == "no_mismatch" and outcome.numbers["errors_mrad"] == [3.0, 2.0, 1.0]


def test_r4_asks_for_drag_alone_and_for_what_it_does_not_explain() -> None:
    drag = found("quadratic_drag", "hinge", d=2e-4)
    assert passes(r4.check, drag, left=True)
    assert not passes(r4.check, drag, left=False)
    assert not passes(r4.check, drag, found("viscous_friction", "hinge", b=1e-4), left=True)
    assert not passes(r4.check, left=True)
    outcome = r4.check({"diagnosis": diagnosed(drag)})
    assert outcome.numbers["drag_per_inertia"] == pytest.approx(2e-4 / (0.0415 * 0.65**2))
    assert "quadratic_drag at hinge (d = 0.0002" in outcome.reached


def test_r6_asks_for_the_frictions_that_the_owners_identified() -> None:
    viscous = found("viscous_friction", "hinge", b=r6.PUBLISHED["Fv"])
    coulomb = found("coulomb_friction", "hinge", c=r6.PUBLISHED["Fc"] * np.pi / 2)
    assert passes(r6.check, viscous, coulomb)
    assert not passes(r6.check, viscous)
    assert not passes(r6.check, replace(viscous, parameters=found("", "", b=0.09).parameters), coulomb)


def test_r1_asks_for_every_push_and_for_no_other() -> None:
    t = 0.01 * np.arange(400, dtype=np.float64)
    pushed = {"tau_pert1": 0.6 * np.exp(-(((t - 1) / 0.1) ** 2)), "tau_pert2": np.zeros(400)}
    tables = [Table(Path("log.csv"), {"time": t, **pushed})]
    name = next(iter(r1.PUSHED))
    right = replace(found("external_pulse", "shoulder", f=0.5), when=[(0.82, 1.18)])
    false = replace(found("external_pulse", "elbow", f=0.5), when=[(3.0, 3.2)])
    passed = [
        r1.check({name: diagnosed(*findings, tables=tables)}).passed for findings in ((right,), (), (right, false))
    ]
    assert passed == [True, False, False]
    calm = [Table(Path("log.csv"), {"time": t})]
    assert r1.check({"undisturbed": diagnosed(tables=calm)}).passed
    assert not r1.check({"undisturbed": diagnosed(false, tables=calm)}).passed


COLUMNS = Columns("t", {"hinge": "q"}, actions={"motor": "u"}, units={"q": "rad"})


def swinging(folder: Path, number: int, seconds: float) -> list[RecordingFile]:
    """Runs of a pendulum with viscous friction that its model lacks, under random torques."""
    model, rng, out = copy.copy(PENDULUM), np.random.default_rng(5), []
    model.dof_damping[:], model.opt.timestep = FRICTION, 0.002
    for i in range(number):
        data, rows = mujoco.MjData(model), ["t,q,u"]
        data.qpos[:] = rng.uniform(-1, 1)
        for k in range(round(seconds / 0.01)):
            data.ctrl[:] = rng.uniform(-1, 1) if k % 10 == 0 else data.ctrl
            rows.append(f"{0.01 * k:.2f},{data.qpos[0] + rng.normal(0, 1e-3)},{data.ctrl[0]}")
            mujoco.mj_step(model, data, 5)
        (folder / f"{i}.csv").write_text("\n".join(rows))
        out.append(RecordingFile(f"{i}.csv", COLUMNS, f"run {i}", "MIT", "a simulation"))
    return out


def test_long_rollouts_follow_what_was_measured_if_friction_is_fitted(tmp_path: Path) -> None:
    runs = [file.recording(tmp_path) for file in swinging(tmp_path, 3, 4.0)]
    rig = Rig(Simulator(PENDULUM, 0.01), JointPositions(PENDULUM, np.full(1, SIGMA)))
    fitted = refit(rig, (ViscousFriction("hinge", 1e-3),), runs[:2], 2.0)
    (friction,) = fitted.effects
    assert isinstance(friction, ViscousFriction) and friction.b == pytest.approx(FRICTION, rel=0.1)
    rollouts, without = (roll(rig, v, runs[2:], 2.0) for v in (fitted, refit(rig, (), runs[:2], 2.0)))
    assert rollouts.error() < 2.0 < 4.0 < without.error()
    assert rollouts.error(0) == rollouts.error()


@pytest.mark.slow
def test_a_gate_diagnoses_its_files_and_draws_what_it_held_out(tmp_path: Path) -> None:
    files = swinging(tmp_path, 7, 3.0)

    def check(diagnoses: Mapping[str, Diagnosed]) -> Outcome:
        b = diagnoses["diagnosis"].estimate("viscous_friction", "b", "hinge")
        return Outcome(diagnoses["diagnosis"].describe(), b == pytest.approx(FRICTION, rel=0.1))

    gate = Gate("R9", "", "", lambda: PENDULUM, {"diagnosis": DataSplit(files[:5], files[5:])}, check, plotted=2.0)
    result = run(gate, tmp_path)
    assert result.passed and result.error is None
    assert [curve.title for curve in result.curves] == ["run 5, hinge", "run 6, hinge"]
    for curve in result.curves:
        refitted, corrected = (np.std(curve.measured - curve.predicted[n]) for n in ("refitted", "corrected"))
        assert corrected < 2e-3 and corrected < refitted


@pytest.mark.parametrize("seed", range(6))
def test_what_is_concealed_is_as_strong_as_was_drawn(seed: int, tmp_path: Path) -> None:
    runs = [file.recording(tmp_path) for file in swinging(tmp_path, 2, 2.0)]
    truth, changed = hidden(runs, PENDULUM, 0.1, np.random.default_rng(seed))
    again = [conceal(r, PENDULUM, truth) for r in runs]
    assert np.sqrt(np.mean([np.max(c.hidden) ** 2 for c in again])) == pytest.approx(0.1, rel=0.02)
    for before, after in zip(runs, changed, strict=True):
        assert np.array_equal(np.asarray(before.qpos), np.asarray(after.qpos))
        assert not np.array_equal(np.asarray(before.action), np.asarray(after.action))


def concealed(files: Sequence[RecordingFile], nulls: float) -> ConcealedGate:
    return ConcealedGate("G9", "", "", [Runs("pendulum", lambda _: PENDULUM, files, 0.2)], 1, nulls, 3)


@pytest.mark.slow
@pytest.mark.parametrize("nulls", [0.0, 1.0])
def test_a_gate_of_concealed_effects_counts_alarms_and_finds(nulls: float, tmp_path: Path) -> None:
    result = concealed(swinging(tmp_path, 6, 3.0), nulls).run(tmp_path)
    assert result.error is None and not result.passed  # a single case cannot show all that is required
    counts = [result.numbers[key] for key in ("nulls", "alarms", "concealed", "placed")]
    assert counts == ([1, 0, 0, 0] if nulls else [0, 0, 1, 1])
    assert list(result.reports) == ["case 0"] and len(result.numbers["cases"]) == 1


def test_a_gate_of_concealed_effects_without_its_files_says_which_is_missing(tmp_path: Path) -> None:
    result = concealed([RecordingFile("none.csv", COLUMNS, "", "", "")], 0.0).run(tmp_path)
    assert isinstance(result.error, InputError) and "none.csv" in result.reached
    assert not result.passed and result.numbers["cases"] == []
