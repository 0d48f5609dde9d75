"""Making and running sealed cases."""

import ast
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from keycld_control.benchmarks.blind import make as making
from keycld_control.benchmarks.blind.case import HELD_OUT, MAX_SPEED, TRAINING, draw_case
from keycld_control.benchmarks.blind.excite import LIMIT
from keycld_control.benchmarks.blind.ideal_observer import Form, separation, told_apart
from keycld_control.benchmarks.blind.make import Settings, make
from keycld_control.benchmarks.blind.measures import REQUIRED, measures
from keycld_control.benchmarks.blind.plan import CATEGORIES, MIX, Plan, mix, plan
from keycld_control.benchmarks.blind.plant import CasePlant, PlantTrajectory
from keycld_control.benchmarks.blind.run import run
from keycld_control.benchmarks.blind.sites import SITES
from keycld_control.benchmarks.blind.strengths import DRIVEN, LIBRARY
from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.recordings import read_dataset

ROOT = Path(__file__).parents[2]
SEED, CASES = 798, 2
"""Two pendulums, one of them released, the other driven: the cheapest cases."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("blind") / "made"
    make(out, Settings(SEED, CASES))
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.slow
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


def test_a_folder_of_something_else_is_left_as_it_is(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="was not made by `keycld blind make`"):
        make(tmp_path, Settings(SEED, CASES))
    assert [p.name for p in tmp_path.iterdir() if not p.name.startswith(".")] == ["mine.txt"]


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


def test_some_categories_keep_their_proportions():
    assert mix(plan(172, 5, ("null", "one"))) == {"null": 72, "one": 100}
    assert mix(plan(7, 5, ("two",))) == {"two": 7}
    assert mix(plan(10, 5, ("null", "outside"))) == {"null": 6, "outside": 4}
    assert plan(40, 5, CATEGORIES) == plan(40, 5)


def test_what_must_be_reached_depends_on_what_is_observed():
    from_states, from_images = (
        {m.measure: m.required for m in measures([], REQUIRED[observe])} for observe in ("states", "pixels")
    )
    assert from_states["one clear effect: name"] == 0.98 and from_images["one clear effect: name"] == 0.95
    assert from_states["seconds per case, longest"] == 60 and from_images["seconds per case, longest"] == 600


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
    """Finds nothing in what is released, and fails on what is driven."""
    if np.any(training[0].action):
        raise ValueError("too hard")
    return {"verdict": "no_mismatch", "findings": [], "fit": {"refitted": np.float64(np.nan)}}


def test_a_run_records_failures_resumes_and_never_reads_answers(made, tmp_path, monkeypatch):
    out = tmp_path / "sealed"
    shutil.copytree(made, out)
    (out / "answers.json").unlink()
    shutil.copy(__file__, tmp_path / "probing.py")
    monkeypatch.syspath_prepend(str(tmp_path))
    (out / "cases" / "0002" / "training" / "01" / "meta.json").write_text("damaged")
    result = run(out, "probing:method")
    assert (result["run"], result["failed"]) == (2, ["0001", "0002"])
    driven, damaged = (
        json.loads((out / "reports-probing.method" / f"000{i}.json").read_text(), parse_constant=pytest.fail)
        for i in (1, 2)
    )
    assert driven["failure"] == "ValueError: too hard" and driven["report"] is None
    assert damaged["failure"].startswith("InputError: ")
    assert min(one[key] for one in (driven, damaged) for key in ("wall_s", "cpu_s")) >= 0
    shutil.copytree(made / "cases" / "0002", out / "cases" / "0002", dirs_exist_ok=True)
    (out / "reports-probing.method" / "0002.json").unlink()
    result = run(out, "probing:method")
    assert (result["run"], result["failed"]) == (1, ["0001"])
    released = json.loads((out / "reports-probing.method" / "0002.json").read_text(), parse_constant=pytest.fail)
    assert released["report"] == {"verdict": "no_mismatch", "findings": [], "fit": {"refitted": None}}
    with pytest.raises(InputError, match="There is no method 'nonsense'"):
        run(out, "nonsense")
    with pytest.raises(InputError, match=r"manifest\.json is missing"):
        run(tmp_path / "nowhere")


@pytest.mark.long
def test_a_ray_cluster_makes_the_same_case_and_runs_it(tmp_path, capsys):
    ray = pytest.importorskip("ray")
    make(tmp_path / "here", Settings(SEED, 1))
    out = str(tmp_path / "there")
    try:
        assert main(["blind", "make", out, "--cases", "1", "--seed", str(SEED), "--ray", "local"]) == 0
        assert contents(Path(out)) == contents(tmp_path / "here")
        capsys.readouterr()
        assert main(["blind", "run", out, "--method", "refit", "--ray", "local", "--json"]) == 0
    finally:
        ray.shutdown()
    told = json.loads(capsys.readouterr().out)
    assert told["run"] == 1 and told["failed"] == []


def test_the_generator_imports_nothing_that_is_measured():
    """Stricter than the import contract, which lists modules: whatever draws and simulates, and all that it imports."""
    package = "keycld_control.benchmarks.blind"
    shared = ("systems", "recordings", "rendering", "disturbance")
    allowed = (*(f"keycld_envs.{name}" for name in shared), package)
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


@pytest.mark.slow
def test_an_ideal_observer_tells_an_effect_no_better_than_it_differs_from_nothing(made, tmp_path, capsys):
    out = tmp_path / "copy"
    shutil.copytree(made, out)
    answers = {a["case"]: a for a in json.loads((out / "answers.json").read_text())}
    assert main(["blind", "ideal", str(out), "--workers", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    clear = [c for c, a in answers.items() if a["category"] == "one" and a["grade"] == "clear"]
    assert [told["case"] for told in found["told"]] == clear
    for told in found["told"]:
        (truth,), written = answers[told["case"]]["truth"], out / "ideal-observer" / f"{told['case']}.json"
        others = json.loads(written.read_text())["others"]
        (nothing,) = [o["nats"] for o in others if o["effect"] == "nothing"]
        assert told["true"]["effect"] == truth["effect"] != told["nearest"]["effect"]
        assert 0 < told["nearest"]["nats"] <= nothing - told["true"]["nats"]
        assert nothing > min(truth["gain_nats"], 100)
        assert len(others) > 1
        assert max(o["numbers"] for o in others) <= told["true"]["numbers"]
        assert told["elsewhere"]["joint"] != told["true"]["joint"]
    files = {p: p.stat().st_mtime_ns for p in (out / "ideal-observer").glob("*.json")}
    assert len(files) == len(clear) > 0
    assert main(["blind", "ideal", str(out), "--workers", "1"]) == 0
    assert "an ideal observer tells" in " ".join(capsys.readouterr().out.split())
    assert files == {p: p.stat().st_mtime_ns for p in (out / "ideal-observer").glob("*.json")}


def test_cases_that_are_drawn_otherwise_have_no_ideal_observer(made, tmp_path, capsys):
    out = tmp_path / "copy"
    shutil.copytree(made, out, ignore=shutil.ignore_patterns("cases"))
    manifest = json.loads((out / "manifest.json").read_text())
    (out / "manifest.json").write_text(json.dumps(manifest | {"seed": SEED + 1}))
    assert main(["blind", "ideal", str(out), "--workers", "1"]) == 2
    assert "draws case" in capsys.readouterr().err


def test_equal_forms_are_told_by_chance():
    others = [Form("actuator_lag", "hinge", 1, nats) for nats in (0.0, 2.0, 1e6)]
    assert told_apart(others[:1]) == 0.5
    assert told_apart(others) == pytest.approx((0.5 + 0.8413 + 1) / 3, abs=1e-4)
    assert told_apart([]) is None


@pytest.mark.slow
def test_no_observer_tells_friction_that_fades_where_nothing_moves_slowly():
    """A released pendulum rests for an instant only: no nats between Stribeck friction and another dry one."""
    plan = Plan("one", "pendulum", "passive", (("stribeck_friction", SITES[0]),))
    case, signals = draw_case(plan, (29112719, 1, 15), filmed=True)
    told = separation(case, signals, making.answer(case, signals, 0, np.array([0.002])))
    assert told.nearest.joint == "hinge" and told.nearest.nats < 2
    assert told.elsewhere.nats > 50
