"""What changed since a baseline: named, placed and sized beside what nobody modelled, or said to be nothing."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from plants import recordings

from keycld_control.cli import main
from keycld_envs.effects import ActuatorDeadZone, AddedInertia, Effect, GravityTilt, SensorLatency, ViscousFriction
from keycld_envs.effects.edited import edited
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, write_recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis import Report, diagnose
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.checks import check_overlap
from keycld_model.diagnosis.discrepancy.compare import compare
from keycld_model.diagnosis.discrepancy.detectable import detectable
from keycld_model.diagnosis.discrepancy.motion import Motion, inverse_dynamics
from keycld_model.diagnosis.discrepancy.outcome import report_of
from keycld_model.diagnosis.discrepancy.regression import regression
from keycld_model.diagnosis.discrepancy.regressors import answer_of, force_of, shared_terms
from keycld_model.diagnosis.discrepancy.selection import Ranked
from keycld_model.diagnosis.output.page import html_page

Force = Callable[..., np.ndarray]


def unmodelled(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """What both sets have, and no simulator: drag and dry friction at all joints."""
    return -0.01 * v * np.abs(v) - 0.05 * np.tanh(v / 0.02)


@cache
def sets(system: str, new: Force | None) -> tuple[list[Recording], list[Recording]]:
    """New recordings with a force more, and a baseline, of one mechanism with its own masses and zeros."""
    before = recordings(system, 3, unmodelled, number=8)[:5]
    if new is None:
        return recordings(system, 3, unmodelled, number=8)[5:], before
    return recordings(system, 3, lambda *now: unmodelled(*now) + new(*now), number=8)[5:], before


def viscous(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    return -0.08 * np.eye(len(v))[-1] * v


def dry(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    return -0.1 * np.eye(len(v))[-1] * np.tanh(v / 0.01)


def vibrating(recording: Recording, number: int) -> Recording:
    """What a mounting that gives way adds: 2 mrad at 9 Hz, at another time in each recording."""
    assert recording.qpos is not None
    t, rng = np.asarray(recording.t_state), np.random.default_rng(number)
    shift = 2e-3 * np.sin(2 * np.pi * 9 * t[:, None] + rng.uniform(0, 2 * np.pi, recording.qpos.shape[1]))
    return replace(recording, qpos=recording.qpos + shift, qvel=None)


@pytest.mark.slow
@pytest.mark.parametrize(
    "system, force, effect, place, parameter, size",
    [
        ("pendulum", dry, "coulomb_friction", "hinge", "c", 0.1),
        pytest.param("cartpole", viscous, "viscous_friction", "hinge_1", "b", 0.08, marks=pytest.mark.long),
        pytest.param("acrobot", viscous, "viscous_friction", "elbow", "b", 0.08, marks=pytest.mark.long),
    ],
)
def test_what_changed_is_named_placed_and_sized(
    system: str, force: Force, effect: str, place: str, parameter: str, size: float
) -> None:
    new, before = sets(system, force)
    report = diagnose(new, get_system(system).compile(), baseline=before)
    assert [(f.effect, f.where["name"]) for f in report.findings] == [(effect, place)]
    found = report.findings[0].parameters[parameter]
    assert found.value == pytest.approx(size, rel=0.1)
    assert found.low < size < found.high
    assert (report.verdict, report.exit_code) == ("mismatch", 10)
    assert report.fit.corrected < report.fit.refitted < report.fit.nominal
    assert report.baseline == [r.id for r in before]


@pytest.fixture(scope="module")
def unchanged() -> Report:
    """Of two sets in which nothing changed."""
    new, before = sets("pendulum", None)
    return diagnose(new, get_system("pendulum").compile(), baseline=before)


@pytest.mark.slow
def test_nothing_changed_though_much_is_missing(unchanged: Report) -> None:
    assert (unchanged.verdict, unchanged.findings, unchanged.exit_code) == ("no_mismatch", [], 0)
    common = {f.effect: f for f in unchanged.common}
    assert common["coulomb_friction"].parameters["c"].value == pytest.approx(0.05, rel=0.25)
    assert all(f.confidence < 0.5 for f in unchanged.common)


@pytest.mark.slow
def test_without_time_nobody_says_that_nothing_changed(unchanged: Report) -> None:
    new, before = sets("pendulum", None)
    report = diagnose(new, get_system("pendulum").compile(), baseline=before, budget=1e-3)
    assert (report.verdict, report.findings, report.details["not_tried"]) == ("undetermined", [], ["pushes"])
    assert "pushes were not looked for" in report.headline
    assert unchanged.details["not_tried"] == []


@pytest.mark.slow
def test_the_page_of_a_comparison_says_what_both_have(unchanged: Report) -> None:
    page = html_page(unchanged)
    assert 'id="common"' in page and 'data-effect="coulomb_friction"' in page
    assert unchanged.evidence is not None
    for shown in (unchanged.evidence.rollouts, unchanged.evidence.residuals):
        assert {r.recording for r in shown if not r.baseline} == set(unchanged.held_out)
        assert {r.recording for r in shown if r.baseline} == set(unchanged.baseline)
    assert f"{unchanged.baseline[0]} (baseline)" in page
    assert 'id="common"' not in html_page(replace(unchanged, baseline=[], common=[]))


@pytest.fixture(scope="module")
def motion() -> tuple[Motion, list[Recording]]:
    """Of runs of the pendulum, which its simulator does not explain."""
    runs = recordings("pendulum", 1, unmodelled, errors=0.0, number=3, seconds=2.0)
    return Motion.of(runs, get_system("pendulum").compile(), STANDARD), runs


def test_forces_that_the_motion_needs_are_those_that_nobody_modelled(motion: tuple[Motion, list[Recording]]) -> None:
    followed, _ = motion
    gear = followed.model.actuator_gear[0, 0]
    needed = followed.over_parts(followed.required - gear * followed.u)
    truth = followed.over_parts(unmodelled(0.0, followed.q, followed.v, followed.u))
    inside = slice(2, -2)  # no sample tells of the last part; encoders that are not at zero shift all by gravity
    slope, _ = np.polyfit(truth[:, inside].ravel(), needed[:, inside].ravel(), 1)
    assert slope == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("effect", [AddedInertia("hinge", 0.02), GravityTilt(alpha=0.1)])
def test_what_edits_a_model_is_the_force_that_it_saves(motion: tuple[Motion, list[Recording]], effect: Effect) -> None:
    followed, _ = motion
    after = inverse_dynamics(edited(followed.model, [effect]), followed.q, followed.v, followed.a)
    assert force_of(followed, effect) == pytest.approx(followed.required - after, abs=1e-9)


def test_forces_are_those_of_the_equations(motion: tuple[Motion, list[Recording]]) -> None:
    followed, _ = motion
    assert force_of(followed, ViscousFriction("hinge", 0.3)) == pytest.approx(-0.3 * followed.vibrating)
    zone = ActuatorDeadZone(followed.model.actuator(0).name, 0.2)
    gear = followed.model.actuator_gear[0, 0]
    steady = np.abs(followed.u[..., 0]) > 0.25
    assert force_of(followed, zone)[steady][:, 0] == pytest.approx(-0.2 * gear * np.sign(followed.u[steady][:, 0]))


def test_a_late_sensor_shows_an_earlier_position(motion: tuple[Motion, list[Recording]]) -> None:
    followed, _ = motion
    late = answer_of(followed, SensorLatency(d=0.01)) * followed.problem.noise[0]
    windows = followed.windows
    speed = np.gradient(windows.measured[..., 0], 0.01, axis=1)
    inside = slice(3, -3)
    assert late[:, inside] == pytest.approx(-0.01 * speed[:, inside], abs=0.01)


def test_forces_that_change_in_every_step_are_answered_step_by_step(motion: tuple[Motion, list[Recording]]) -> None:
    followed, _ = motion
    rng, shape, parts = np.random.default_rng(0), followed.v.shape, followed.forces.shape[1]
    steady = np.repeat(rng.normal(size=(shape[0], parts, 1)), np.diff(followed.windows.edges(parts)), axis=1)
    assert followed.answer_by_step(steady) == pytest.approx(followed.answer(steady), rel=0.02, abs=0.5)
    begun = np.where(np.arange(shape[1]) == 0, 1.0, 0.0)[None, :, None] * np.ones(shape)
    late = np.roll(begun, 1, axis=1)  # the same mean over the first part; what it did comes a step later
    assert followed.answer(late) == pytest.approx(followed.answer(begun))
    early, later = (followed.answer_by_step(f) for f in (begun, late))
    assert np.all(np.abs(later - early).max(axis=1) > 0.02 * np.abs(early).max(axis=1))
    assert not followed.answer_by_step(0 * steady).any()


def words(recordings: Sequence[Recording], folder: Path) -> str:
    for r in recordings:
        write_recording(folder / r.id, r)
    return str(folder)


def renamed(recording: Recording, id: str) -> Recording:
    return replace(recording, id=id)


def test_sets_that_cannot_be_compared_are_refused_with_both_named() -> None:
    model = get_system("pendulum").compile()
    new, before = sets("pendulum", None)
    with pytest.raises(InputError, match="1 run; at least two"):
        diagnose(new, model, baseline=before[:1])
    with pytest.raises(InputError, match="in the baseline, too"):
        diagnose(before[:2], model, baseline=before)
    with pytest.raises(InputError, match="held_out"):
        diagnose(new, model, held_out=before, baseline=before)
    slow = [replace(r, t_state=np.asarray(r.t_state) * 5, t_action=np.asarray(r.t_action) * 5) for r in new]
    with pytest.raises(InputError, match="every 50 ms, the baseline, such as 'run-0', every 10 ms"):
        diagnose(slow, model, baseline=before)
    other = [replace(r, joint_names=("elbow",)) for r in before]
    with pytest.raises(InputError, match=r"'run-5' has the joints \['hinge'\], the baseline 'run-0' has \['elbow'\]"):
        diagnose(new, model, baseline=other)
    rng = np.random.default_rng(0)
    resting = [
        replace(r, qpos=rng.normal(0, 1e-3, np.asarray(r.qpos).shape), action=0 * np.asarray(r.action)) for r in new
    ]
    with pytest.raises(InputError, match="The recordings hardly move: hinge by"):
        diagnose(resting, model, baseline=before)
    with pytest.raises(InputError, match=r"For 90 % of the time, the speed of hinge .* excite both alike"):
        check_overlap({"command of motor": 1.0, "speed of hinge": 0.9})
    degrees = [replace(r, qpos=np.rad2deg(np.asarray(r.qpos))) for r in new]
    with pytest.raises(
        InputError, match=r"qpos of 'hinge' over a range of .* the baseline, such as 'run-0', of .* units"
    ):
        diagnose(degrees, model, baseline=before)
    weaker = [replace(r, action=1e-3 * np.asarray(r.action)) for r in before]
    with pytest.raises(InputError, match=r"action of .* units"):
        diagnose(new, model, baseline=weaker)
    with pytest.raises(InputError, match="'copy' equals 'run-0' of the baseline"):
        diagnose([renamed(before[0], "copy")], model, baseline=before)
    short = replace(
        new[0],
        t_state=np.asarray(new[0].t_state)[:45],
        qpos=np.asarray(new[0].qpos)[:45],
        qvel=None,
        action=None,
        t_action=None,
    )
    with pytest.raises(InputError, match=r"motion for 1 windows .* Record for longer|hardly move"):
        diagnose([short], model, baseline=[replace(r, action=None, t_action=None) for r in before])


@pytest.mark.slow
def test_a_change_that_rollouts_do_not_bear_out_gives_way_to_a_rival_that_they_do() -> None:
    new, before = sets("pendulum", dry)
    model, time = get_system("pendulum").compile(), lambda what: False
    found = compare(new, before, model, STANDARD, lambda *now: None, time)
    (right,) = found.changes
    contest = found.selection.contest
    spring = next(c for c in contest.candidates if c.hypothesis.effect.id == "spring")
    difference = contest.test(spring, contest.baseline, contest.new)
    wrong = replace(
        right,
        effect=difference.effect,
        deviations=np.zeros(2),
        ranked=Ranked(difference, 1.0),
        rivals=((right.ranked, 0.1),),
    )
    report = report_of(replace(found, changes=[wrong]), model, [r.id for r in before], STANDARD)
    assert [f.effect for f in report.findings] == ["coulomb_friction"]
    assert report.findings[0].confidence < 0.43 and "spring" in report.findings[0].rivals
    alone = report_of(replace(found, changes=[replace(wrong, rivals=())]), model, [r.id for r in before], STANDARD)
    assert (alone.verdict, alone.findings[0].effect) == ("undetermined", "spring")
    assert alone.findings[0].confidence < 0.2 and not alone.fit.better
    assert alone.evidence is not None and alone.evidence.corrected is not None
    assert "spring" not in {e.id for e in alone.evidence.effects}


@pytest.mark.long
def test_clocks_may_count_from_any_time_and_samples_be_missing(unchanged: Report) -> None:
    new, before = sets("pendulum", viscous)
    moved = []
    for r in new:
        q = np.array(r.qpos)
        q[40:44] = np.nan
        late = {name: np.asarray(getattr(r, name)) + 1e9 for name in ("t_state", "t_action")}
        moved.append(replace(r, qpos=q, **late))
    report = diagnose(moved, get_system("pendulum").compile(), baseline=before)
    assert [(f.effect, f.where["name"]) for f in report.findings] == [("viscous_friction", "hinge")]


@pytest.mark.long
def test_what_is_detectable_is_found_and_what_is_far_below_is_not() -> None:
    model, before = get_system("pendulum").compile(), sets("pendulum", None)[1]
    least = {(d.effect, d.parameter): d for d in detectable(before, model)}
    b = least["viscous_friction", "b"]
    assert (b.where, b.unit) == ("hinge", "N m s/rad")
    assert b.force == pytest.approx(b.size * np.sqrt(np.mean(np.concatenate([speed(r) for r in before]) ** 2)), rel=0.1)
    for factor, found in ((3.0, ["viscous_friction"]), (0.2, [])):
        new = recordings("pendulum", 3, lambda *now, k=factor: unmodelled(*now) - k * b.size * now[2], number=8)[5:]
        assert [f.effect for f in diagnose(new, model, baseline=before).findings] == found


def speed(recording: Recording) -> np.ndarray:
    return np.gradient(np.asarray(recording.qpos)[:, 0], 0.01)


@pytest.mark.slow
def test_keycld_diagnose_with_a_baseline(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new, before = sets("pendulum", dry)
    today, baseline = words([renamed(r, f"new-{r.id}") for r in new], tmp_path / "new"), words(before, tmp_path / "old")
    out = tmp_path / "report"
    assert main(["diagnose", today, "--baseline", baseline, "--env", "pendulum", "--out", str(out)]) == 10
    report = json.loads((out / "report.json").read_text())
    assert report["findings"][0]["effect"] == "coulomb_friction"
    assert 0.5 < report["findings"][0]["confidence"] <= report["findings"][0]["family_confidence"] <= 1
    assert (out / "report.html").is_file() and (out / "corrected.xml").is_file()
    assert main(["detectable", baseline, "--env", "pendulum", "--out", str(tmp_path / "least.html"), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out.splitlines()[-1])["detectable"]
    assert {"coulomb_friction", "actuator_delay", "sensor_latency"} <= {row["effect"] for row in rows}
    assert (tmp_path / "least.html").is_file()
    assert main(["diagnose", today, "--baseline", str(tmp_path / "none"), "--env", "pendulum"]) == 2


@pytest.mark.long
def test_a_vibration_takes_no_masses_away() -> None:
    new, before = ([vibrating(r, i) for i, r in enumerate(some)] for some in sets("acrobot", viscous))
    motion = Motion.of(before, get_system("acrobot").compile(), STANDARD)
    terms = shared_terms(motion, STANDARD)
    everywhere = np.ones(len(motion.windows), bool)
    nothing = np.zeros((*motion.residual.shape, 0))
    found, discrepancy = regression(motion, terms, nothing, everywhere)
    values = found.solve(everywhere, nothing, np.zeros(0)).values
    assert np.all(discrepancy.vibration * motion.problem.noise > 1e-3)
    masses = [v for term, v in zip(terms, values, strict=True) if term.name.startswith("mass of")]
    assert len(masses) == 2 and np.all(np.abs(masses) < 0.25)
    report = diagnose(new, get_system("acrobot").compile(), baseline=before)
    (finding,) = report.findings
    assert (finding.effect, finding.where["name"]) == ("viscous_friction", "elbow")
    assert finding.parameters["b"].value == pytest.approx(0.08, rel=0.2)


@pytest.mark.long
def test_what_hardly_stands_out_is_perhaps_a_change() -> None:
    new, before = sets("pendulum", dry)
    model = get_system("pendulum").compile()
    times = diagnose(new, model, baseline=before).details["times_chance"][0]
    report = diagnose(new, model, baseline=before, criteria=replace(STANDARD, changed=1.2 * times))
    assert (report.verdict, report.exit_code, report.findings) == ("undetermined", 11, [])
    assert report.details["next_best"]["effect"] == "coulomb_friction" and "hinge" in report.headline
    strict = replace(STANDARD, changed=2.4 * times)
    assert diagnose(new, model, baseline=before, criteria=strict).verdict == "no_mismatch"
