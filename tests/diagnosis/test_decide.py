"""What stands where a step of the diagnosis fails."""

from dataclasses import replace

import numpy as np
import pytest
from plants import problem_of, recordings

from keycld_envs.effects import BaseMotion, CoulombFriction, ViscousFriction
from keycld_envs.errors import InputError
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.replay import replay, rollout_error
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.output.words import headline
from keycld_model.diagnosis.search.criterion import Scored
from keycld_model.diagnosis.search.explain import Explanation
from keycld_model.diagnosis.search.search import Search
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.decide import Conclusion, decide_on_named, doubted, never_worse, settled
from keycld_model.diagnosis.verdict.dropped import Dropped
from keycld_model.diagnosis.verdict.findings import far_off, findings_of, may_be_absent
from keycld_model.diagnosis.verdict.held_out import HeldOut
from keycld_model.diagnosis.verdict.other_way_round import other_way_round
from keycld_model.diagnosis.verdict.report import Estimate, Finding, FitErrors, Unexplained
from keycld_model.diagnosis.verdict.rivals import Rivals


def test_a_step_in_which_numbers_run_away_is_left_out_with_a_line():
    dropped = Dropped()
    assert dropped.tried("fine", lambda: 3) == 3 and not dropped
    assert dropped.tried("singular", lambda: np.linalg.inv(np.zeros((2, 2)))) is None
    assert len(dropped) == 1 and dropped[0].startswith("singular: ")


def test_what_a_user_can_repair_and_bugs_are_not_left_out():
    def fail(error: Exception):
        raise error

    for error in (InputError("record for longer."), AttributeError("q"), ValueError("shapes (2,) and (3,)")):
        with pytest.raises(type(error)):
            Dropped().tried("step", lambda error=error: fail(error))


@pytest.mark.parametrize("friction, expected", [(0.008, "mismatch"), (0.0, "no_mismatch")])
def test_what_held_out_recordings_deny_as_strongly_as_others_ask_for_it_is_not_said(friction, expected):
    """Three recordings ask for friction, and others tell whether it was a coincidence."""
    model = get_system("pendulum").compile()
    runs, others = (
        recordings("pendulum", seed, lambda t, q, v, u, b=b: -b * v, number=number, seconds=1.0)
        for seed, number, b in ((0, 3, 0.008), (0, 15, friction))
    )
    problem = problem_of(Simulator(model, 0.01), runs)
    refitted = minimise(problem, problem.start())
    best = Scored.of(minimise(problem, refitted.point.with_effects(ViscousFriction("hinge", b=0.008))))
    explained = Explanation(Search(problem), refitted, best, None)
    found = [Finding.of(ViscousFriction("hinge", b=0.008), {}, 0.9)]
    tested = HeldOut.of(others, refitted)
    assert explained.gain > STANDARD.certain
    concluded = decide_on_named(explained, found, tested.short(refitted), tested)
    assert (concluded.verdict, bool(concluded.findings)) == (expected, expected == "mismatch")


@pytest.mark.parametrize(
    "force, expected",
    [(lambda t, q, v, u: -0.02 * np.tanh(50 * v), CoulombFriction), (lambda t, q, v, u: -0.02 * v, ViscousFriction)],
    ids=["dry", "viscous"],
)
def test_of_forms_that_training_recordings_hardly_tell_apart_all_recordings_choose(force, expected):
    """Two recordings of a viscous friction, and others of one form or the other."""
    model = get_system("pendulum").compile()
    runs = recordings("pendulum", 0, lambda t, q, v, u: -0.02 * v, number=2, seconds=1.0)
    others = recordings("pendulum", 1, force, number=15, seconds=1.0)
    problem = problem_of(Simulator(model, 0.01), runs)
    refitted, search = minimise(problem, problem.start()), Search(problem)
    forms = ViscousFriction("hinge", b=0.02), CoulombFriction("hinge", c=0.02)
    best, other = (search.refine(refitted.point.with_effects(form)) for form in forms)
    assert best.score < other.score < best.score + 50
    explained, tested = Explanation(search, refitted, best, None), HeldOut.of(others, refitted)
    assert search.near(best) == [other]
    chosen = settled(explained, [other], tested)
    (effect,) = chosen.best.fit.effects
    assert isinstance(effect, expected)
    (finding,) = findings_of(chosen, Rivals(chosen, {effect.key: []}, Dropped()))
    assert finding.confidence > 0.9


def test_findings_that_leave_a_simulator_worse_than_it_was_are_not_sure():
    """A refit that went far astray, which an effect mends by half."""
    model = get_system("pendulum").compile()
    runs = recordings("pendulum", 0, number=3, seconds=1.0)
    problem = problem_of(Simulator(model, 0.01), runs)
    good = minimise(problem, problem.start())
    astray, less = (replay(problem, with_friction(good, b)) for b in (0.4, 0.2))
    best = Scored.of(less)
    explained = Explanation(Search(problem), astray, best, None)
    found = [Finding.of(ViscousFriction("hinge", b=0.2), {}, 0.9)]
    tested = HeldOut.of(recordings("pendulum", 1, number=3, seconds=1.0), astray)
    concluded, rollouts = never_worse(Conclusion("mismatch", less, less, found, 40.0), explained, tested)
    nominal, refitted, corrected = map(rollout_error, rollouts)
    assert nominal < corrected < refitted and concluded.verdict == "undetermined" and concluded.findings


def with_friction(fit: Fit, b: float) -> Fit:
    """The same with friction, nothing fitted to it."""
    return replace(fit, point=fit.point.with_effects(ViscousFriction("hinge", b=b)))


def test_an_effect_that_only_held_out_recordings_show_clearly_is_named_and_not_called_unknown():
    """Friction gains 5.4 nats on three short recordings, of which six are asked, and 13.5 on fifteen others."""
    every = recordings("pendulum", 0, lambda t, q, v, u: -0.005 * v, number=18, seconds=1.0)
    report = diagnose(every[:3], get_system("pendulum").compile(), every[3:])
    (found,) = report.findings
    assert report.verdict == "mismatch" and "viscous_friction" in {found.effect, *found.rivals}
    assert STANDARD.doubtful < report.details["gain_nats"] < STANDARD.effect < report.details["held_out_gain_nats"]


@pytest.mark.parametrize(
    "verdict, significant, fraction, expected",
    [
        ("no_mismatch", True, 0.01, "undetermined"),
        ("no_mismatch", False, 0.0, "no_mismatch"),
        ("mismatch", True, 0.2, "undetermined"),
        ("mismatch", True, 0.05, "mismatch"),
    ],
)
def test_nothing_is_certain_where_more_than_noise_is_left(verdict, significant, fraction, expected):
    model = get_system("pendulum").compile()
    problem = problem_of(Simulator(model, 0.01), recordings("pendulum", 0, number=1, seconds=0.5))
    fit = Fit(problem, problem.start(), 0.0, np.eye(0))
    named = Conclusion(verdict, fit, fit, [], 0.0)
    assert doubted(named, Unexplained(significant, fraction, None, "")).verdict == expected


def test_what_could_as_well_be_absent_is_no_cause_of_a_large_misfit():
    model = get_system("pendulum").compile()
    problem = problem_of(Simulator(model, 0.01), recordings("pendulum", 0, number=1, seconds=0.5))
    fit, left = Fit(problem, problem.start(), 0.0, np.eye(0)), Unexplained(True, 0.03, "hinge", "")
    speed = Estimate(13.9, "rad/s", 11.8, 15.9)
    for low, expected in ((-240.0, "undetermined"), (20.0, "mismatch")):
        sizes = {"a": Estimate(30.0, "m/s^2", low, 40.0), "b": Estimate(-1.0, "m/s^2", -9.0, 9.0), "w": speed}
        named = Conclusion("mismatch", fit, fit, [Finding.of(BaseMotion("z"), sizes, 0.9)], 40.0)
        assert doubted(named, left).verdict == expected
    unknown = Finding.of(ViscousFriction("hinge", b=0.1), {}, 0.9)
    assert not may_be_absent(unknown)


def test_lengths_and_zeros_that_are_far_off_are_said():
    model = get_system("pendulum").compile()
    problem = problem_of(Simulator(model, 0.01), recordings("pendulum", 0, number=1, seconds=0.5))
    point, values = problem.start(), {"length": np.log(2.25), "mass": -0.3, "zero": -0.07}
    changed = replace(point.variant, values=tuple(values.get(n.kind, 0.0) for n in problem.nuisances))
    assert far_off(Fit(problem, point, 0.0, np.eye(0))) == []
    odd = far_off(Fit(problem, replace(point, variant=changed), 0.0, np.eye(0)))
    assert odd == ["the length of pole is 2.25 times the simulator's", "the zero of hinge is off by -0.07 rad"]
    errors, left = FitErrors("", "mrad", 1.0, 1.0, 1.0), Unexplained(False, 0.0, None, "")
    assert headline("no_mismatch", [], errors, left, odd[:1]).endswith(
        "For that, the length of pole is 2.25 times the simulator's: check the simulator, the units and the clocks."
    )
    assert headline("no_mismatch", [], errors, left).endswith("only noise is left.")


def _told(change) -> str | None:
    model = get_system("acrobot").compile()
    runs = [change(r) for r in recordings("acrobot", 0, number=2, seconds=1.0)]
    simulator, seen = Simulator(model, 0.01), JointPositions(model)
    return other_way_round(runs, seen.calibrated(runs), simulator, STANDARD)


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda r: r, None),
        (lambda r: replace(r, action=np.asarray(r.action) * [1, -1]), "the commands of 'elbow' count the other way"),
        (lambda r: replace(r, qpos=np.asarray(r.qpos) * [1, -1]), "the positions of 'elbow' count the other way"),
        (lambda r: replace(r, qpos=np.cumsum(r.qpos, axis=1)), "the positions of 'elbow' count from the ground"),
    ],
)  # fmt: skip
def test_columns_that_are_written_down_otherwise_are_told(change, said):
    told = _told(change) or ""
    assert told == "" if said is None else said in told and "times nearer to the recordings" in told


def test_positions_read_off_images_are_no_other_observation():
    model = get_system("pendulum").compile()
    with pytest.raises(InputError, match="tracked"):
        diagnose([], model, tracked=True, observation=JointPositions(model))
