"""Real recordings: their import, the protocol of the gates, and how they are scored."""

import json
import os
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from keycld_control.benchmarks.real import GATES, Curve, Gate, GateResult, pushes, run
from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, Outcome
from keycld_control.benchmarks.real.grading import Case, passed, share, summary
from keycld_control.benchmarks.real.owners.gate import OwnersGate
from keycld_control.benchmarks.real.owners.versus import OwnersRig
from keycld_control.benchmarks.real.plots import write_page
from keycld_control.benchmarks.real.replay import SIGMA, Observed, refit, roll
from keycld_control.benchmarks.real.rivals.answer import Answer
from keycld_control.benchmarks.refitting import JointPositions, Simulator
from keycld_control.cli import main
from keycld_envs.effects import CoulombFriction, QuadraticDrag, ViscousFriction
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.verdict.report import Estimate, Finding, FitErrors, Report, Unexplained

DATA = Path(os.environ.get("KEYCLD_REAL", Path(__file__).parents[2].parent / "shared" / "real"))
real = [pytest.mark.real, pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} does not exist")]


def report(*pulses: tuple[str, float, float, float]) -> Report:
    findings = [
        Finding(
            "external_pulse",
            "force",
            {"kind": "joint", "name": joint},
            {"f": Estimate(f, "N m", f, f)},
            "",
            1.0,
            [],
            when=[(a, b)],
        )
        for joint, a, b, f in pulses
    ]
    return Report("mismatch", "", findings, {}, Unexplained(False, 0, None, ""), FitErrors("", "", 1, 1, 1), [])


def test_pushes_are_scored_by_overlap_joint_and_samples() -> None:
    t = 0.01 * np.arange(300, dtype=np.float64)
    torque = np.zeros((300, 2))
    torque[:, 0] = 0.6 * np.exp(-(((t - 1) / 0.1) ** 2)) + 0.1 * np.exp(-(((t - 2) / 0.1) ** 2))
    ((a, b),) = pushes.true_windows(t, torque[:, 0], 0.2)
    assert (a, b) == (pytest.approx(0.85, abs=0.01), pytest.approx(1.15, abs=0.01))
    torques = {"shoulder": torque[:, 0], "elbow": torque[:, 1]}
    right = pushes.score(report(("shoulder", a, b, 0.5)), "run", t, torques, 0.2)
    assert right.overlaps == [1.0] and right.false == 0
    assert right.auc == pytest.approx(0.8, abs=0.15)
    wrong = pushes.score(report(("elbow", a, b, 0.5)), "run", t, torques, 0.2)
    assert (wrong.overlaps, wrong.false) == ([0.0], 1)
    assert wrong.auc is not None and wrong.auc < 0.5
    weak = pushes.score(report(("shoulder", 1.9, 2.1, 0.1)), "run", t, torques, 0.2)
    assert (weak.overlaps, weak.false) == ([0.0], 0)  # it need not be found, and is there
    elsewhere = report(("shoulder", a, b, 0.5))
    elsewhere = replace(elsewhere, findings=[replace(f, when_by_recording={"run": f.when}) for f in elsewhere.findings])
    assert pushes.score(elsewhere, "run", t, torques, 0.2).overlaps == [1.0]
    assert pushes.score(elsewhere, "another run", t, torques, 0.2).overlaps == [0.0]
    none = {joint: np.zeros_like(t) for joint in torques}
    assert pushes.score(report(), "run", t, none, 0.2) == pushes.PushScore([], 0, None)


@pytest.mark.parametrize("score, expected", [([1, 2, 3, 4], 1.0), ([4, 3, 2, 1], 0.0), ([1, 1, 1, 1], 0.5)])
def test_area_under_the_curve(score: list[float], expected: float) -> None:
    assert pushes.auc(np.array(score, float), np.array([False, False, True, True])) == expected


OWNERS = """I1: 0.031887199591513114
I2: 0.05086984812807257
Ir: 6.287203962819607e-05
gr: 6.0
l1: 0.2
m1: 0.5234602302310271
m2: 0.6255677234174437
r1: 0.2
r2: 0.25569305436052964
"""
"""design_C.1/model_1.0/model_parameters.yml, without friction."""


def test_rigs_have_the_inertias_of_their_owners(tmp_path: Path) -> None:
    """Mass matrix and gravity at two angles, by the textbook, rotor included."""
    path = tmp_path / "dfki_double_pendulum/data/system_identification/identified_parameters/design_C.1/model_1.0"
    path.mkdir(parents=True)
    (path / "model_parameters.yml").write_text(OWNERS)
    model = diagnosed("G3").simulator(tmp_path)
    data, dense = mujoco.MjData(model), np.empty((2, 2))
    for elbow in (0.0, 1.0):
        data.qpos[:] = 0.3, elbow
        mujoco.mj_forward(model, data)
        for j in range(2):
            mujoco.mj_mulM(model, data, dense[j], np.eye(2)[j])
        i1, i2, m2, r2, l1 = 0.031887199591513114, 0.05086984812807257, 0.6255677234174437, 0.25569305436052964, 0.2
        coupling, rotor = m2 * l1 * r2 * np.cos(elbow), 36 * 6.287203962819607e-05
        assert dense[0, 0] == pytest.approx(i1 + i2 + m2 * l1**2 + 2 * coupling + rotor)
        assert dense[0, 1] == pytest.approx(i2 + coupling)
        assert dense[1, 1] == pytest.approx(i2 + rotor)
        assert data.qfrc_bias[1] == pytest.approx(9.81 * m2 * r2 * np.sin(0.3 + elbow))
    hanging = diagnosed("G4").simulator(tmp_path)
    data = mujoco.MjData(hanging)
    data.qpos[:] = np.pi + 0.01
    mujoco.mj_forward(hanging, data)
    assert data.qacc[0] == pytest.approx(-64.29 * np.sin(0.01), rel=1e-3)


def test_the_page_of_a_gate_shows_what_was_required(tmp_path: Path) -> None:
    t = np.linspace(0, 1, 20)
    curve = Curve("run <1>, hinge", "rad", t, np.sin(t), {"refitted": np.sin(t) + 0.1, "corrected": np.sin(t)})
    result = GateResult("R9", "a rig & <b>more", "< 2 mrad", "3 mrad", False, {}, 1.0, curves=[curve])
    write_page(result, tmp_path / "R9.html")
    page = (tmp_path / "R9.html").read_text().replace(get_plotlyjs(), "")
    assert '<h1 data-passed="false">R9, a rig &amp; &lt;b&gt;more' in page
    assert re.search('<p id="required">.*&lt; 2 mrad</p>', page) and re.search('<p id="reached">.*3 mrad</p>', page)
    assert "lt;1" in page and "<1>" not in page and not re.search('src="http|<link', page)


class Told:
    """What is expected of a diagnosis that is not run; its check may fail."""

    of = ()

    def required(self) -> str:
        return "to swing"

    def check(self, diagnosed: Diagnosed) -> Outcome:
        raise AssertionError


def gate(name: str, error: Exception | None = None) -> Gate:
    """A gate without a diagnosis, which may fail."""

    def model(folder: Path) -> mujoco.MjModel:
        raise error if error is not None else AssertionError

    diagnoses = {} if error is None else {"diagnosis": DataSplit([])}
    return Gate(name, "a rig", model, diagnoses, [Told()])


def test_a_gate_that_cannot_run_leaves_the_others_and_what_they_reached(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(GATES, "R2", gate("R2"))  # the real ones take minutes
    monkeypatch.setitem(GATES, "R6", gate("R6"))
    out = tmp_path / "out"
    assert main(["real", str(tmp_path), "--only", "R2,R4,R6", "--out", str(out), "--json"]) == 2
    said = capsys.readouterr()
    told = {one["gate"]: one for one in json.loads(said.out)["gates"]}
    assert {name: one["passed"] for name, one in told.items()} == {"R2": True, "R4": False, "R6": True}
    assert "lab1_data.txt" in said.err and "lab1_data.txt" in told["R4"]["reached"]
    assert {p.stem: json.loads(p.read_text()) for p in out.glob("*.json")} == told


def test_an_error_of_a_gate_is_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(GATES, "R2", gate("R2", ZeroDivisionError("no windows")))
    with pytest.raises(ZeroDivisionError):
        main(["real", str(tmp_path), "--only", "R2", "--out", str(tmp_path)])
    assert not json.loads((tmp_path / "R2.json").read_text())["passed"]


def test_a_wrong_folder_or_gate_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        ([str(tmp_path / "none")], "is no folder; docs/real-data.md"),
        ([str(tmp_path), "--only", "R4,R7"], f"--only names 'R7'; there are {', '.join(GATES)}."),
        ([str(tmp_path), "--only", "r4"], "lab1_data.txt does not exist; docs/real-data.md"),
    ):
        assert main(["real", *words]) == 2
        assert message in capsys.readouterr().err


def diagnosed(name: str) -> Gate:
    """A gate with a diagnosis of its own."""
    gate = GATES[name]
    assert isinstance(gate, Gate)
    return gate


def recordings(name: str) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings of a gate with one diagnosis."""
    data: DataSplit = diagnosed(name).diagnoses["diagnosis"]
    return [file.recording(DATA) for file in data.recordings], [file.recording(DATA) for file in data.held_out]


@pytest.mark.parametrize("case", [pytest.param("", marks=real)])
def test_recordings_are_what_the_documentation_says(case: str) -> None:
    training, held_out = recordings("G4")
    assert [len(np.asarray(r.t_state)) for r in (*training, *held_out)] == [9167] * 5 + [9166]
    ((string,), _), ((motor,), _) = recordings("R4"), recordings("R6")
    times = np.asarray(string.t_state)
    assert (len(times), times[-1]) == (2330, pytest.approx(116.41, abs=0.01))
    assert np.ptp(np.asarray(motor.action)) > 30
    logged = diagnosed("G2").diagnoses["acrobot"].recordings[0].table(DATA)
    torques = [logged.column(f"tau_pert{j}") for j in (1, 2)]
    found = [pushes.true_windows(logged.column("time"), torque, 0.2) for torque in torques]
    assert [len(f) for f in found] == [2, 2]
    logged = diagnosed("R2").diagnoses["diagnosis"].recordings[0].table(DATA)
    v = logged.column("vel_filt2")
    formula = 0.001 * v + 0.12 * np.arctan(100 * v)
    assert np.abs(formula - logged.column("tau_fric2")).max() < 1e-9


def _of_owners(rig: OwnersRig, folder: Path) -> mujoco.MjModel:
    return rig.owners(folder)[0].simulator


@pytest.mark.parametrize("case", [pytest.param("", marks=real)])
def test_every_file_of_every_gate_is_a_recording_of_its_simulator(case: str) -> None:
    for gate in GATES.values():
        if isinstance(gate, Gate):
            several = [(gate.simulator, [f for d in gate.diagnoses.values() for f in (*d.recordings, *d.baseline)])]
        elif isinstance(gate, OwnersGate):
            several = [(partial(_of_owners, rig), [*rig.training, *rig.held_out]) for rig in gate.rigs]
        else:
            several = [(runs.simulator, runs.files) for runs in gate.runs]
        for simulator, files in several:
            model = simulator(DATA)
            for recording in (file.recording(DATA) for file in files):
                assert recording.joint_names == tuple(model.joint(j).name for j in range(model.njnt))
                assert recording.actuator_names == tuple(model.actuator(i).name for i in range(model.nu))


@pytest.mark.slow
@pytest.mark.parametrize("case", [pytest.param("", marks=real)])
def test_dry_friction_of_the_pendubot_is_found_at_both_joints(case: str) -> None:
    result = run(GATES["G3"], DATA)
    assert result.passed, result.reached


@pytest.mark.parametrize("case", [pytest.param("", marks=real)])
def test_two_dissipation_terms_together_explain_what_either_makes_worse(case: str) -> None:
    """The figures of gate G4: viscous friction alone leaves 6.5 and 16.3 mrad."""
    training, held_out = recordings("G4")
    model, seconds = diagnosed("G4").simulator(DATA), 9.17
    observed = Observed(Simulator(model, 0.009), JointPositions(model, np.full(1, SIGMA)))
    hinge, errors = "hinge", {}
    for name, effects in {
        "viscous": (ViscousFriction(hinge, 1e-4),),
        "coulomb and drag": (CoulombFriction(hinge, 3e-4), QuadraticDrag(hinge, 1e-5)),
    }.items():
        fitted = refit(observed, effects, training, seconds)
        rollouts = roll(observed, fitted, held_out, seconds)
        errors[name] = [rollouts.error(i) for i in range(2)]
    assert errors["viscous"] == [pytest.approx(6.5, abs=0.5), pytest.approx(16.3, abs=0.5)]
    assert max(np.array(errors["coulomb and drag"]) / errors["viscous"]) < 0.6


def test_a_concealed_effect_is_graded_by_name_place_size_and_interval() -> None:
    def found(effect: str, where: str, value: float, rivals: list[str]) -> Answer:
        size = {"c": Estimate(value, "N m", value - 0.05, value + 0.05)}
        finding = Finding(effect, "dissipation", {"kind": "joint", "name": where}, size, "", 0.7, rivals)
        fit = FitErrors("", "mrad", 3, 2, 1)
        report = Report("mismatch", "", [finding], {}, Unexplained(False, 0, None, ""), fit, [])
        return Answer.of_report(report)

    truth = CoulombFriction("elbow", 0.3)
    right = Case("rig", ["a"], truth, found("coulomb_friction", "elbow", 0.33, []), 1.0).grade()
    assert [right[k] for k in ("named", "in_set", "placed", "sized", "covered", "error_falls")] == [True] * 4 + [
        [True],
        True,
    ]
    rival = Case("rig", ["a"], truth, found("stribeck_friction", "elbow", 0.4, ["coulomb_friction"]), 1.0).grade()
    assert [rival[k] for k in ("named", "in_set", "placed", "sized")] == [False, True, True, False]
    elsewhere = Case("rig", ["a"], truth, found("coulomb_friction", "shoulder", 0.3, []), 1.0).grade()
    assert [elsewhere[k] for k in ("named", "placed")] == [False, False]
    refused = Case("rig", ["a"], truth, Answer("undetermined", failure="too short"), 1.0).grade()
    assert [refused[k] for k in ("named", "among", "placed", "sized", "failure")] == [False] * 4 + ["too short"]
    alarm = Case("rig", ["a"], None, found("coulomb_friction", "elbow", 0.3, []), 1.0).grade()
    counts = summary([right, rival, elsewhere, alarm])
    assert (counts["alarms"], counts["named"], counts["in_set"], counts["placed"]) == (1, 1, 2, 2)
    assert not passed(counts)
    assert share(0, 30) == "0 of 30 (0.00 to 0.12)"
