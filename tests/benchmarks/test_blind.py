"""Making, running and scoring sealed cases."""

import ast
import hashlib
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from keycld_control.benchmarks.blind import make as making
from keycld_control.benchmarks.blind.case import HELD_OUT, MAX_SPEED, TRAINING, draw_case
from keycld_control.benchmarks.blind.excite import LIMIT
from keycld_control.benchmarks.blind.make import Settings, make
from keycld_control.benchmarks.blind.match import CaseResult
from keycld_control.benchmarks.blind.plan import MIX, Plan, mix, plan
from keycld_control.benchmarks.blind.plant import CasePlant, PlantTrajectory
from keycld_control.benchmarks.blind.run import run
from keycld_control.benchmarks.blind.score import score
from keycld_control.benchmarks.blind.sites import SITES, sites
from keycld_control.benchmarks.blind.strengths import DRIVEN, LIBRARY
from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.recordings import read_dataset

ROOT = Path(__file__).parents[2]
SEED, CASES = 11, 2


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("blind") / "made"
    make(out, Settings(SEED, CASES))
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_an_interrupted_making_goes_on_and_gives_the_same_bytes(made, tmp_path, monkeypatch):
    out, each = tmp_path / "again", making.each

    def one_only(function, items, workers, ray):
        yield from each(function, items[:1], workers, ray)
        raise KeyboardInterrupt

    monkeypatch.setattr(making, "each", one_only)
    with pytest.raises(KeyboardInterrupt):
        make(out, Settings(SEED, CASES))
    assert not (out / "manifest.json").exists() and not (out / "answers.json").exists()
    first = contents(out / "cases")
    times = {p: p.stat().st_mtime_ns for p in (out / "cases" / "0001").rglob("*")}
    monkeypatch.setattr(making, "each", each)
    make(out, Settings(SEED, CASES))
    assert first.items() <= contents(out / "cases").items()
    assert times == {p: p.stat().st_mtime_ns for p in (out / "cases" / "0001").rglob("*")}
    assert contents(out) == contents(made)
    with pytest.raises(InputError, match=r"settings\.json is of a benchmark with other settings"):
        make(out, Settings(SEED + 1, CASES))


def test_the_cases_tell_nothing(made):
    """Neither words nor sizes of files, nor anything but motion and commands."""
    answers = json.loads((made / "answers.json").read_text())
    about = [json.loads((made / "cases" / a["case"] / "case.json").read_text()) for a in answers]
    for case, answer in zip(about, answers, strict=True):
        assert set(case) == {"schema", "id", "system", "observe", "excitation"}
        folder = made / "cases" / answer["case"]
        words = b"".join(p.read_bytes() for p in folder.rglob("*.json")).decode()
        assert not [effect for effect in LIBRARY if effect in words]
        assert answer["category"] not in words and "seed" not in words.replace('"seed": null', "")
        training, held_out = (read_dataset(folder / part).recordings for part in ("training", "held_out"))
        assert (len(training), len(held_out)) == (TRAINING, HELD_OUT)
        signals = list(folder.rglob("signals.npz"))
        assert len({p.stat().st_size for p in signals}) == 1
        samples, names = 4 * answer["rate"], {tuple(sorted(np.load(p).files)) for p in signals}
        assert names == {("action", "qpos", "t_action", "t_state")}
        assert all(len(np.asarray(r.t_state)) == len(np.asarray(r.t_action)) == samples for r in training)
        assert all(np.abs(np.asarray(r.action)).max() <= LIMIT for r in (*training, *held_out))
    assert not (made / ".answers").exists()


def test_the_mix_is_kept_and_effects_come_evenly():
    plans = plan(300, 5)
    assert mix(plans) == {c: round(300 * share) for c, share in MIX.items()}
    singles = [p.parts[0][0] for p in plans if p.category == "one"]
    counts = [singles.count(effect) for effect in LIBRARY]
    assert max(counts) - min(counts) <= 1
    for p in plans:
        assert len({e for e, _ in p.parts}) == len(p.parts)
        assert p.excitation != "passive" or not {e for e, _ in p.parts} & set(DRIVEN)
        assert all(site.system == p.system for _, site in p.parts)
    assert {s.name for p in plans for _, s in p.parts} == {s.name for s in SITES}
    assert [p.category for p in plan(300, 6)] != [p.category for p in plans]
    assert len(plan(1, 0)) == 1


def test_the_taxonomy_is_covered():
    """All 27 of its table but "unknown"."""
    assert len(LIBRARY) == 27
    for effect, draw in LIBRARY.items():
        for site in SITES:
            mechanism = draw(site, np.random.default_rng(0), True)
            assert mechanism.id == effect
            assert json.loads(json.dumps(mechanism.parameters()))


def test_no_run_is_faster_than_promised(monkeypatch):
    speeds = []
    simulate = CasePlant.simulate

    def watch(self, *args) -> PlantTrajectory | None:
        path = simulate(self, *args)
        if path is not None:
            speeds.append(np.abs(path.v).max())
        return path

    monkeypatch.setattr(CasePlant, "simulate", watch)
    case, signals = draw_case(Plan("null", "acrobot", "open_loop"), (3, 3))
    assert max(speeds) <= MAX_SPEED
    assert all(s.level <= level for s, level in zip(signals, case.levels, strict=True))


def method(training, held_out, model):
    """Finds viscous friction everywhere, but cannot read the second case."""
    if training[0].system.endswith("Acrobot-v0"):
        raise ValueError("too many joints")
    return {"verdict": "mismatch", "findings": []}


def test_a_run_records_failures_resumes_and_never_reads_answers(made, tmp_path, monkeypatch):
    out = tmp_path / "sealed"
    shutil.copytree(made, out)
    (out / "answers.json").unlink()
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    shutil.copy(__file__, tmp_path / "probing.py")
    monkeypatch.syspath_prepend(str(tmp_path))
    systems = [json.loads((out / "cases" / f"000{i}" / "case.json").read_text())["system"] for i in (1, 2)]
    result = run(out, "probing:method")
    assert result["run"] == 2
    assert result["failed"] == [f"000{i + 1}" for i, s in enumerate(systems) if s.endswith("Acrobot-v0")]
    for i, system in enumerate(systems):
        report = json.loads((out / "reports-probing.method" / f"000{i + 1}.json").read_text())
        assert (report["failure"] == "ValueError: too many joints") == system.endswith("Acrobot-v0")
        assert report["wall_s"] >= 0 and report["cpu_s"] >= 0
    (out / "reports-probing.method" / "0001.json").unlink()
    assert run(out, "probing:method")["run"] == 1
    with pytest.raises(InputError, match="There is no method 'nonsense'"):
        run(out, "nonsense")
    with pytest.raises(InputError, match=r"manifest\.json is missing"):
        run(tmp_path / "nowhere")


def test_a_ray_cluster_makes_the_same_cases_and_runs_them(made, tmp_path, capsys):
    ray = pytest.importorskip("ray")
    out = str(tmp_path / "spread")
    try:
        assert main(["blind", "make", out, "--cases", str(CASES), "--seed", str(SEED), "--ray", "local"]) == 0
        assert contents(Path(out)) == contents(made)
        capsys.readouterr()
        assert main(["blind", "run", out, "--method", "refit", "--ray", "local", "--json"]) == 0
    finally:
        ray.shutdown()
    told = json.loads(capsys.readouterr().out)
    assert told["run"] == CASES and told["failed"] == []


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


def test_the_generator_imports_nothing_that_is_measured():
    """Stricter than the import contract, which lists modules: whatever draws and simulates, and all that it imports."""
    package = "keycld_control.benchmarks.blind"
    allowed = ("keycld_envs.systems", "keycld_envs.recordings", package)
    todo, seen = [f"{package}.case", f"{package}.plan"], set()
    while todo:
        module = todo.pop()
        seen.add(module)
        tree = ast.parse((ROOT / Path(*module.split("."))).with_suffix(".py").read_text())
        froms = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and (n.module or "").startswith("keycld")]
        assert not [
            n for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names if a.name.startswith("keycld")
        ]
        for name in {n.module or "" for n in froms}:
            assert name.startswith(allowed) and not name.endswith(".grade"), f"{module} imports {name}"
            if name == f"{package}.mechanisms":
                todo += [f"{name}.{p.stem}" for p in (ROOT / Path(*name.split("."))).glob("[a-z]*.py")]
            elif name.startswith(package) and name not in seen:
                todo.append(name)
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    listed = next(c for c in contracts if "sealed cases" in c["name"])["source_modules"]
    assert {m for m in seen if ".mechanisms." not in m} <= set(listed)
