"""Scoring the reports of sealed cases."""

import hashlib
import json
import shutil

import pytest

from keycld_control.benchmarks.blind.match import CaseResult
from keycld_control.benchmarks.blind.score import score
from keycld_control.benchmarks.blind.sites import sites
from keycld_control.cli import main
from keycld_envs.errors import InputError


def answer(case, category, truth=(), system="acrobot", **more):
    truth = [
        {
            "effect": e,
            "where": {"kind": k, "name": n},
            "joint": sites(system)[0].name,
            "parameters": {},
            "comparable": c,
        }
        | {"gain_nats": nats, "grade": "clear" if nats > 10 else "hidden"}
        for e, k, n, c, nats in truth
    ]
    about = {"case": case, "category": category, "system": system, "excitation": "open_loop", "grade": "clear"}
    return about | {"truth": truth, "oracle": {"value": 1.0}, "moved": [2.0, 2.0]} | more


def said(findings=(), verdict="mismatch", refitted=11.0, corrected=1.0, unexplained=False):
    findings = [
        {
            "effect": e,
            "where": {"kind": k, "name": n},
            "rivals": [rival for rival, _, _ in r],
            "rivals_where": [{"kind": kind, "name": name} for _, kind, name in r],
            "parameters": p,
        }
        for e, k, n, r, p in findings
    ]
    fit = {"refitted": refitted, "corrected": corrected}
    return {"verdict": verdict, "findings": findings, "fit": fit, "unexplained": {"significant": unexplained}}


B = {"b": {"value": 0.1, "low": 0.09, "high": 0.12}}
VISCOUS = ("viscous_friction", "joint", "elbow", {"b": 0.1}, 50.0)
PULSE = ("external_pulse", "joint", "elbow", {}, 50.0)
GAIN = ("actuator_gain", "actuator", "torque", {"k": 0.8}, 50.0)
HAND_MADE = [
    (answer("0001", "null"), said(verdict="no_mismatch", corrected=11.0)),
    (answer("0002", "null"), said([("cogging", "joint", "elbow", [], {})], "undetermined")),
    (answer("0003", "one", [VISCOUS]), said([("viscous_friction", "body", "lower_arm", [], B)])),
    (answer("0004", "one", [VISCOUS]), said([("quadratic_drag", "joint", "elbow", [VISCOUS[:3]], {})])),
    (
        answer("0005", "one", [GAIN], "pendulum"),
        said([("added_inertia", "joint", "hinge", [GAIN[:3]], {})]),
    ),
    (answer("0006", "one", [(*VISCOUS[:4], 2.0)]), said(verdict="no_mismatch", corrected=11.5)),
    (
        answer("0007", "two", [VISCOUS, PULSE]),
        said([("external_pulse", "joint", "elbow", [], {}), ("viscous_friction", "joint", "elbow", [], B)]),
    ),
    (answer("0008", "two", [VISCOUS, PULSE]), said([("viscous_friction", "joint", "elbow", [], B)])),
    (
        answer("0009", "outside", [("unknown", "joint", "elbow", {}, 50.0)]),
        said(verdict="undetermined", unexplained=True),
    ),
    (answer("0010", "outside", [("unknown", "joint", "elbow", {}, 50.0)]), None),
]


@pytest.fixture
def hand_made(tmp_path):
    content = json.dumps([a for a, _ in HAND_MADE]).encode()
    (tmp_path / "answers.json").write_bytes(content)
    manifest = {"schema": "keycld.blind/1", "generator": "1", "seed": 0, "cases": len(HAND_MADE), "mix": {"null": 2}}
    manifest["answers_sha256"] = hashlib.sha256(content).hexdigest()
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    (tmp_path / "reports").mkdir()
    for a, report in HAND_MADE:
        result = {"case": a["case"], "wall_s": 2.0, "cpu_s": 3.0, "report": report}
        result["failure"] = "ValueError: x" if report is None else None
        (tmp_path / "reports" / f"{a['case']}.json").write_text(json.dumps(result))
    return tmp_path


def test_the_score_counts_what_the_contract_says(hand_made):
    result = score(hand_made)["methods"]["diagnose"]
    rows = {row["measure"]: row for row in result["rows"]}

    def counted(measure):
        return rows[measure]["hits"], rows[measure]["count"]

    assert counted("false alarms on null cases") == (1, 2)
    assert rows["false alarms on null cases"]["met"] is False
    assert rows["false alarms on null cases"]["interval"] == pytest.approx((0.01258, 0.98742), abs=1e-4)
    assert counted("one clear effect: name") == (1, 3)
    assert counted("one clear effect: place") == (3, 3)
    assert counted("one clear effect: name, counting rivals") == (3, 3)
    assert counted("one clear effect: name, exact aliases left out") == (1, 2)
    assert counted("two clear effects: both named and placed") == (1, 2)
    assert rows["three clear effects: all named and placed"]["reached"] is None
    assert rows["oracle recovery R, clear effects: median"]["reached"] == pytest.approx(1.0)
    assert rows["oracle recovery R, clear effects: median"]["count"] == 3
    assert counted("outside the library: says so") == (1, 2)
    assert counted("indistinguishable: returns the set") == (1, 1)
    assert rows["indistinguishable: mean size of the set"]["reached"] == 2
    assert counted("coverage of the 90 % intervals") == (2, 2)
    assert counted("corrected worse than refitted, held out") == (1, 9)
    assert rows["seconds per case, longest"]["reached"] == 2.0
    assert counted("failed with an error") == (1, 10)
    assert result["confusion"]["viscous_friction"] == {"viscous_friction": 1, "quadratic_drag": 1, "nothing": 1}
    assert [case["case"] for case in result["wrong"]] == ["0002", "0004", "0005", "0008", "0010"]
    page = (hand_made / "score.md").read_text()
    assert "| one clear effect: name | ≥ 0.98 | 0.333 (1/3, 0.008 to 0.906) ✗ |" in page
    assert "quadratic_drag at elbow" in page


def test_baselines_stand_side_by_side(hand_made, capsys):
    shutil.copytree(hand_made / "reports", hand_made / "reports-refit")
    assert main(["blind", "score", str(hand_made)]) == 0
    assert "refit" in capsys.readouterr().out
    assert "| measure | required | diagnose | refit |" in (hand_made / "score.md").read_text()
    (hand_made / "reports-refit" / "0003.json").unlink()
    with pytest.raises(InputError, match=r"reports-refit/0003\.json is missing or damaged; .*--method refit"):
        score(hand_made)
    methods = score(hand_made, partial=True)["methods"]
    assert (methods["diagnose"]["cases"], methods["refit"]["cases"]) == (10, 9)
    assert "1 cases have no report yet." in (hand_made / "score.md").read_text()


def test_other_answers_than_the_sealed_ones_are_refused(hand_made, capsys):
    path = hand_made / "answers.json"
    path.write_bytes(path.read_bytes() + b"\n")
    assert main(["blind", "score", str(hand_made)]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert "answers_sha256" in captured.err
    assert not (hand_made / "score.md").exists()


def test_recovery_leaves_out_what_cannot_be_recovered():
    result = {"report": said(refitted=1.02, corrected=1.0), "failure": None}
    assert CaseResult(answer("1", "one", [VISCOUS]), result).recovery is None
    result = {"report": said(refitted=9.0, corrected=5.0), "failure": None}
    assert CaseResult(answer("1", "one", [VISCOUS]), result).recovery == pytest.approx(0.5)
    assert CaseResult(answer("1", "two", [VISCOUS, PULSE]), result).recovery is None


def test_filmed_cases_are_compared_with_the_error_of_the_positions_that_were_read():
    filmed = answer("1", "one", [VISCOUS]) | {"oracle": {"value": None}}
    report = said(refitted=9.0, corrected=5.0) | {"details": {"images": {"error": [0.0006, 0.0013]}}}
    oracle = 1e3 * ((0.0006**2 + 0.0013**2) / 2 * (1 - 2 / 160)) ** 0.5
    result = CaseResult(filmed, {"report": report, "failure": None})
    assert result.recovery == pytest.approx(4 / (9 - oracle))
    assert CaseResult(filmed, {"report": said(), "failure": None}).recovery is None
