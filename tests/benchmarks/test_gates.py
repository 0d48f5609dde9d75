"""What gates on real recordings ask of diagnoses, and effects that are concealed in recordings."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from keycld_control.benchmarks.real import GATES, Gate, expectations, run
from keycld_control.benchmarks.real.concealed import ConcealedGate
from keycld_control.benchmarks.real.concealing import hidden
from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, RecordingFile, Runs
from keycld_control.benchmarks.real.halves import HalvesGate
from keycld_control.benchmarks.real.replay import SIGMA, Observed, refit, roll
from keycld_control.benchmarks.real.simulators import Link, Pendulum
from keycld_control.benchmarks.refitting import JointPositions, Simulator
from keycld_envs.conceal import conceal
from keycld_envs.effects import ViscousFriction
from keycld_envs.errors import InputError
from keycld_envs.recordings.importers import Columns
from keycld_model.diagnosis.verdict.report import Estimate, Finding, FitErrors, Report, Unexplained

PENDULUM = Pendulum(Link(1.0, 0.5, 0.3), motor=True).model(Path())
FRICTION = 0.05
NOMINAL = {f"{what} of link": Estimate(1.0, "1", 0.9, 1.1) for what in ("mass", "length")}


def found(effect: str, where: str, **values: float) -> Finding:
    sizes = {name: Estimate(value, "N m", value, value) for name, value in values.items()}
    return Finding(effect, "dissipation", {"kind": "joint", "name": where}, sizes, "", 1.0, [])


def passes(name: str, *findings: Finding, left: bool = False) -> bool:
    """Whether a gate with one diagnosis is reached by findings."""
    gate = GATES[name]
    assert isinstance(gate, Gate)
    errors, rest = FitErrors("", "mrad", 3.0, 2.0, 1.0), Unexplained(left, 0.1, None, "")
    report = Report("mismatch" if findings else "no_mismatch", "", list(findings), NOMINAL, rest, errors, [])
    diagnosed = Diagnosed(PENDULUM, [], [], [], [], report, 1.0)
    return all(expectation.check(diagnosed).passed for expectation in gate.expectations)


def test_r2_asks_for_both_frictions_and_no_viscous_one() -> None:
    shoulder, elbow = found("coulomb_friction", "shoulder", c=0.251), found("coulomb_friction", "elbow", c=0.188)
    assert passes("R2", shoulder, elbow)
    assert not passes("R2", shoulder)
    assert not passes("R2", shoulder, found("coulomb_friction", "elbow", c=0.226))
    assert not passes("R2", shoulder, elbow, found("viscous_friction", "elbow", b=0.001))


def test_r4_asks_for_drag_alone_and_for_what_it_does_not_explain() -> None:
    drag = found("quadratic_drag", "hinge", d=2e-4)
    assert passes("R4", drag, left=True)
    assert not passes("R4", drag, left=False)
    assert not passes("R4", drag, found("viscous_friction", "hinge", b=1e-4), left=True)
    assert not passes("R4", left=True)


def test_r6_asks_for_the_frictions_that_the_owners_identified() -> None:
    viscous, coulomb = found("viscous_friction", "hinge", b=0.04707), found("coulomb_friction", "hinge", c=0.289)
    assert passes("R6", viscous, coulomb)
    assert not passes("R6", viscous)
    assert not passes("R6", found("viscous_friction", "hinge", b=0.09), coulomb)


def test_g3_asks_for_dry_friction_of_any_form_and_no_smooth_one() -> None:
    shoulder = found("asymmetric_friction", "shoulder", forward=0.21, backward=0.29)
    elbow = found("stribeck_friction", "elbow", c=0.15, extra=0.4, vs=0.1)
    assert passes("G3", shoulder, elbow)
    assert not passes("G3", elbow)
    assert not passes("G3", found("asymmetric_friction", "shoulder", forward=0.1, backward=0.29), elbow)
    assert not passes("G3", shoulder, elbow, found("quadratic_drag", "elbow", d=0.01))


def test_g5_asks_for_mass_or_torque_and_for_the_doubt() -> None:
    gain = replace(found("actuator_gain", "motor", k=0.465), rivals=["added_inertia"])
    mass = replace(found("added_inertia", "link", m=0.575, x=1.0), rivals=["actuator_gain"])
    assert passes("G5", gain) and passes("G5", mass)
    assert not passes("G5", replace(gain, rivals=[])) and not passes("G5")
    assert not passes("G5", replace(found("actuator_gain", "motor", k=0.9), rivals=["added_inertia"]))


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
    observed = Observed(Simulator(PENDULUM, 0.01), JointPositions(PENDULUM, np.full(1, SIGMA)))
    fitted = refit(observed, (ViscousFriction("hinge", 1e-3),), runs[:2], 2.0)
    (friction,) = fitted.effects
    assert isinstance(friction, ViscousFriction) and friction.b == pytest.approx(FRICTION, rel=0.1)
    rollouts, without = (roll(observed, v, runs[2:], 2.0) for v in (fitted, refit(observed, (), runs[:2], 2.0)))
    assert rollouts.error() < 2.0 < 4.0 < without.error()
    assert rollouts.error(0) == rollouts.error()


@pytest.mark.long
def test_a_gate_diagnoses_its_files_and_draws_what_it_held_out(tmp_path: Path) -> None:
    files = swinging(tmp_path, 7, 3.0)

    friction = expectations.Finding(effect=("viscous_friction",), between={"b": (0.9 * FRICTION, 1.1 * FRICTION)})
    error = expectations.Error(most=0.5, seconds=2.0)
    gate = Gate("R9", "", lambda _: PENDULUM, {"": DataSplit(files[:5], files[5:])}, [friction, error], plotted=2.0)
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
    return ConcealedGate("G9", "", [Runs("pendulum", lambda _: PENDULUM, files, 0.2)], 1, nulls, 3)


@pytest.mark.slow
@pytest.mark.parametrize("nulls", [0.0, 1.0])
def test_a_gate_of_concealed_effects_counts_alarms_and_finds(nulls: float, tmp_path: Path) -> None:
    result = concealed(swinging(tmp_path, 6, 3.0), nulls).run(tmp_path)
    assert result.error is None and not result.passed  # a single case cannot show all that is required
    counts = [result.numbers[key] for key in ("nulls", "alarms", "concealed", "placed")]
    assert counts == ([1, 0, 0, 0] if nulls else [0, 0, 1, 1])
    (case,) = result.numbers["cases"]
    assert case["case"] == 0 and case["report"]["verdict"] == case["verdict"]


def test_a_gate_of_concealed_effects_without_its_files_says_which_is_missing(tmp_path: Path) -> None:
    result = concealed([RecordingFile("none.csv", COLUMNS, "", "", "")], 0.0).run(tmp_path)
    assert isinstance(result.error, InputError) and "none.csv" in result.reached
    assert not result.passed and result.numbers["cases"] == []


@pytest.mark.long
def test_a_gate_of_halves_diagnoses_both_and_compares_them(tmp_path: Path) -> None:
    runs = Runs("pendulum", lambda _: PENDULUM, swinging(tmp_path, 6, 3.0))
    result = HalvesGate("G9", "", [runs], 1, 0).run(tmp_path)
    assert result.error is None and list(result.reports) == ["pendulum 0a", "pendulum 0b"]
    (own,) = result.numbers["rigs"].values()
    assert own["findings"] >= 2 and own["confirmed"] == own["findings"]
    assert {f["effect"] for f in result.numbers["found"]} == {"viscous_friction"}
