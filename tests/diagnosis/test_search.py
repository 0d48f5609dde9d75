"""Searches that would end in the wrong optimum."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plants import problem_of, recordings

from keycld_envs import KeyCLDEnv
from keycld_envs.effects import (
    EFFECTS,
    ActuatorDelay,
    ActuatorLag,
    AsymmetricFriction,
    Backlash,
    ConstantForce,
    CoulombFriction,
    Effect,
    HystereticFriction,
    QuadraticDrag,
    SensorLatency,
    StribeckFriction,
    ViscousFriction,
)
from keycld_envs.effects.added_mass import AddedMass
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.pulses import contaminated
from keycld_model.diagnosis.estimation.replay import replay
from keycld_model.diagnosis.search.alternatives import everywhere_rivals, rivals_of
from keycld_model.diagnosis.search.budget import Budget
from keycld_model.diagnosis.search.criterion import Scored, form_price
from keycld_model.diagnosis.search.explain import _with_effects_of, explain_either
from keycld_model.diagnosis.search.search import Search
from keycld_model.diagnosis.simulation.simulator import Simulator


def loose(truth: Backlash, number: int = 4, samples: int = 160):
    """Recordings of a cartpole with play at its motor."""
    env = KeyCLDEnv("cartpole", obs_type="state", effects=[truth])
    form, rng, out = recordings("cartpole", 0, number=1, seconds=0.5)[0], np.random.default_rng(1), []
    t = 0.01 * np.arange(samples)
    for run in range(number):
        env.reset(seed=run)
        u = np.repeat(rng.uniform(-3, 3, (samples // 10, 2)), 10, axis=0)
        q = np.array([env.step(a)[4]["qpos"] for a in u]) + rng.normal(0, 3e-4, (samples, 2))
        out.append(replace(form, id=str(run), t_action=t - 0.01, action=u, t_state=t, qpos=q))
    return out


@pytest.mark.long
def test_play_is_found_from_numbers_far_off():
    truth = Backlash("slide", j=0.085, g=0.006)
    simulator = Simulator(KeyCLDEnv("cartpole", obs_type="state").model)
    problem = problem_of(simulator, loose(truth), 3e-4)
    start = minimise(problem, problem.start()).point
    far = start.with_effects(Backlash("slide", j=0.3, g=0.0005))
    others = {kind.id for kind in EFFECTS.values()} - {Backlash.id}
    best = Search(problem, others).run(start, far.variant.effects)
    found = next(e for e in best.fit.effects if e.where == "slide")
    assert isinstance(found, Backlash)
    assert best.fit.cost < minimise(problem, far, 40).cost - 100
    # As good as from the truth, from which its numbers may differ: gap and contact stand for each other.
    assert best.fit.cost < minimise(problem, start.with_effects(truth), 40).cost + 30


def test_beside_strong_pushes_an_effect_must_gain_its_share_of_all():
    def friction(_t, _q, v, _u):
        return np.array([-0.02 * np.tanh(v[0] / 0.01)])

    runs = recordings("pendulum", 2, friction, number=4, seconds=2.0)
    simulator = Simulator(KeyCLDEnv("pendulum", obs_type="state").model)
    problem = problem_of(simulator, runs)
    start = minimise(problem, problem.start())
    others = {kind.id for kind in EFFECTS.values()} - {"coulomb_friction"}
    alone = Search(problem, others).run(start.point)
    assert {effect.id for effect in alone.fit.effects} == {"coulomb_friction"}
    gain = start.cost - alone.fit.cost
    assert Search(problem, others, gained=20 * gain).run(start.point).keys == alone.keys
    assert not Search(problem, others, gained=200 * gain).run(start.point).keys


def test_a_set_without_a_spurious_term_wins_though_it_gains_less_than_a_round_must():
    """It explains as much, to within what an effect must gain."""
    simulator = Simulator(KeyCLDEnv("pendulum", obs_type="state").model)
    problem = problem_of(simulator, recordings("pendulum", 2, number=1, seconds=0.5))
    point = problem.start()

    def scored(score: float, *effects: Effect) -> Scored:
        return Scored(Fit(problem, point.with_effects(*effects), 0.0, np.eye(0)), score)

    nothing, single = scored(500.0), scored(96.4, ViscousFriction("hinge"))
    pair = scored(100.0, ViscousFriction("hinge"), QuadraticDrag("hinge"))
    assert pair.improves_on(nothing, 6.0) and single.improves_on(pair, 6.0)
    assert not pair.improves_on(single, 6.0) and not single.improves_on(scored(90.0, *pair.fit.effects), 6.0)


def test_an_effect_is_also_tried_at_its_other_places():
    """Of two sets with another effect in one's place that are followed, one was that effect itself."""
    env = KeyCLDEnv("acrobot", obs_type="state", effects=[AddedMass("lower_arm", m=0.3, x=1.9)])
    form, rng, runs = recordings("acrobot", 0, number=1, seconds=0.5)[0], np.random.default_rng(1), []
    t = 0.01 * np.arange(100)
    for run in range(4):
        env.reset(seed=run)
        u = np.repeat(rng.uniform(-1, 1, (10, 2)), 10, axis=0)
        q = np.array([env.step(a)[4]["qpos"] for a in u]) + rng.normal(0, 1e-3, (100, 2))
        runs.append(replace(form, id=str(run), t_action=t - 0.01, action=u, t_state=t, qpos=q))
    problem = problem_of(Simulator(KeyCLDEnv("acrobot", obs_type="state").model, 0.01), runs)
    search = Search(problem, {"external_pulse", "base_motion"})
    best = search.refine(minimise(problem, problem.start()).point.with_effects(AddedMass("upper_arm", m=0.19, x=0.2)))
    search.exchange(best, best.fit.effects[0])
    places = {where for keys in search.found if len(keys) == 1 for kind, where in keys if kind == "AddedMass"}
    assert places == {"upper_arm", "lower_arm"}


def test_friction_alike_in_both_directions_has_one_number():
    """The form with two numbers gains less than an effect must; beside it the search once ended with .41 and .40."""

    def friction(_t, _q, v, _u):
        return np.array([-0.45 * np.tanh(v[0] / 0.01)])

    problem = problem_of(
        Simulator(KeyCLDEnv("pendulum", obs_type="state").model),
        recordings("pendulum", 2, friction, number=4, seconds=2.0),
    )
    others = {kind.id for kind in EFFECTS.values()} - {"coulomb_friction", "asymmetric_friction"}
    search = Search(problem, others)
    best = search.run(minimise(problem, problem.start()).point, [AsymmetricFriction("hinge", 0.45, 0.45)])
    assert {effect.id for effect in best.fit.effects} == {"coulomb_friction"}
    assert search.best.score < best.score  # the other form is better by some nats


def test_a_set_is_simplified_as_far_as_it_goes(monkeypatch):
    """The two likeliest sets that were simpler than three effects had two of them; that with one was left out."""
    problem = problem_of(
        Simulator(KeyCLDEnv("pendulum", obs_type="state").model, 0.01), recordings("pendulum", 3, number=2, seconds=0.8)
    )
    friction, clock = CoulombFriction("hinge", 0.1), SensorLatency("clock", 0.001)
    bristles = HystereticFriction("hinge", c=0.1)
    sets = {
        (friction, QuadraticDrag("hinge", 0.1), clock): 100.0,
        (friction, clock): 100.6,
        (QuadraticDrag("hinge", 0.1), clock): 100.8,
        (friction,): 101.0,
        (bristles,): 99.0,
        (): 250.0,
    }
    search = Search(problem)
    scored = [Scored(replay(problem, minimise(problem, problem.start(), 1)), score) for score in sets.values()]
    of_sets = zip(scored, sets, strict=True)
    scored = [replace(s, fit=replace(s.fit, point=s.fit.point.with_effects(*effects))) for s, effects in of_sets]
    search.found, search._nothing = {s.keys: s for s in scored}, 250.0
    monkeypatch.setattr(search, "refine", lambda point: search.found[frozenset(e.key for e in point.effects)])
    assert search._simplified(scored[0]).keys == {friction.key}
    assert search._simplified(scored[3]) is scored[3]
    # Of one effect, a form with more numbers has paid for them.
    assert search._simplified(scored[4]) is scored[4]
    search._nothing = 1e4  # but with no form is a misfit of so many nats described to a part in two thousand
    assert search._simplified(scored[4]).keys == {friction.key}


def test_a_number_of_which_recordings_tell_nothing_costs_nothing():
    friction = StribeckFriction("hinge", c=0.04, extra=0.0, vs=0.2)
    fit: Any = SimpleNamespace(precision=lambda effect: np.diag([1e6, 1e4, 0.0]))
    # The extra friction is as uncertain before as the sliding one is large.
    assert form_price(fit, friction) == pytest.approx(0.5 * np.log1p(1e4 * 0.04**2))
    assert form_price(fit, friction, dispersion=4.0) == pytest.approx(0.5 * np.log1p(1e4 * 0.04**2 / 4))
    told: Any = SimpleNamespace(precision=lambda effect: np.diag([1e6, 1e4, 100.0]))
    assert form_price(told, friction) - form_price(fit, friction) == pytest.approx(0.5 * np.log1p(100 * 0.2**2))
    single: Any = SimpleNamespace(precision=lambda effect: np.array([[1e6]]))
    assert form_price(single, CoulombFriction("hinge", 0.04)) == 0.0


def test_two_effects_at_one_joint_are_also_tried_as_one():
    """A force beside dry friction is friction that differs by direction."""

    def friction(_t, _q, v, _u):
        return np.array([-(0.055 if v[0] > 0 else 0.034) * np.tanh(abs(v[0]) / 0.01) * np.sign(v[0])])

    problem = problem_of(
        Simulator(KeyCLDEnv("pendulum", obs_type="state").model),
        recordings("pendulum", 2, friction, number=4, seconds=2.0),
    )
    search = Search(problem)
    both = minimise(problem, problem.start()).point.with_effects(CoulombFriction("hinge", 0.04), ConstantForce("hinge"))
    best = search.refine(both)
    search.unite(best)
    one = search.found[frozenset({AsymmetricFriction("hinge").key})]
    assert one.score < best.score


def test_windows_that_stick_out_are_seen_where_all_together_look_like_noise():
    def fit(*above: float) -> Any:
        costs = np.full(80, 40.0)
        costs[: len(above)] += above
        problem = SimpleNamespace(costs=lambda point: costs, samples=6400, windows=range(80), criteria=STANDARD)
        return SimpleNamespace(problem=problem, point=None)

    assert not contaminated(fit()) and not contaminated(fit(200.0)) and not contaminated(fit(19.0, 19.0, 19.0))
    assert contaminated(fit(21.0, 22.0))


def test_no_effect_stands_twice_in_a_set():
    """A set without one of two of the same key had the same key as with both, so that pruning it never ended."""
    runs = recordings("pendulum", 3, number=3, seconds=1.2)
    simulator = Simulator(KeyCLDEnv("pendulum", obs_type="state").model, 0.01)
    problem = problem_of(simulator, runs)
    others, sets = {kind.id for kind in EFFECTS.values()} - {"actuator_lag", "actuator_delay"}, []
    search = Search(problem, others, refined=lambda scored: sets.append(scored.fit.effects) if scored else None)
    late = ActuatorLag("torque", lag=0.02), ActuatorDelay("torque", d=0.02)
    best = search.refine(problem.start().with_effects(*late))
    sets.clear()
    for effect in best.fit.effects:
        search.exchange(best, effect)
    tried = [[e.key for e in effects] for effects in sets]
    assert tried and all(len(keys) == len(set(keys)) for keys in tried)


def test_no_delay_of_motors_stands_in_for_sensors_that_are_ahead():
    """A negative latency has no rival among delays: it was copied into one, beyond its bounds, which ended a search."""
    ahead = []
    for run in recordings("cartpole", 3, number=3, seconds=1.2):
        assert run.qpos is not None and run.t_state is not None
        ahead.append(replace(run, qpos=run.qpos[1:], t_state=run.t_state[:-1]))
    simulator = Simulator(KeyCLDEnv("cartpole", obs_type="state").model, 0.01)
    problem = problem_of(simulator, ahead)
    search = Search(problem, {kind.id for kind in EFFECTS.values()} - {"sensor_latency", "actuator_delay"})
    best = search.run(problem.start(), [SensorLatency(d=-0.005)])
    (effect,) = best.fit.effects
    assert isinstance(effect, SensorLatency) and effect.d < -0.005
    rivals_of(search, best, effect)
    everywhere_rivals(search, best)
    delays = [e for s in search.found.values() for e in s.fit.effects if isinstance(e, ActuatorDelay)]
    assert all(e.d >= 0 for e in delays)


def test_where_both_integrators_leave_but_noise_the_accurate_one_is_taken():
    """With the model's own, a lag makes up for steps that are too long; noise is taken for thrice its size."""
    model, runs = get_system("pendulum").compile(), recordings("pendulum", 3, number=3, seconds=2.0)
    accurate, own = (
        minimise(problem, problem.start())
        for problem in (problem_of(simulator, runs, 3e-3) for simulator in (Simulator(model, 0.01), Simulator(model)))
    )
    assert own.excess < 0 and accurate.excess < 0 and own.problem.simulator.own_integrator
    explained = explain_either(accurate, own, lambda scored: None, Budget())
    assert not explained.refitted.problem.simulator.own_integrator and not explained.best.fit.effects


def test_another_integrator_also_begins_without_what_clocks_have_made_up_for():
    simulator = Simulator(KeyCLDEnv("pendulum", obs_type="state").model)
    problem = problem_of(simulator, recordings("pendulum", 2, number=1, seconds=0.5))
    point, friction, early = problem.start(), ViscousFriction("hinge", 0.1), SensorLatency(d=-0.01)

    def begun(*effects: Effect) -> list[tuple[Effect, ...]]:
        second = Fit(problem, point, 0.0, np.eye(0))
        best = Fit(problem, point.with_effects(*effects), 0.0, np.eye(0))
        return [tuple(start.variant.effects) for start in _with_effects_of(best, second)]

    assert begun(friction) == [(friction,)]
    assert begun(early, friction) == [(early, friction), (friction,)]


@pytest.mark.long
def test_a_simulation_with_steps_of_euler_lacks_its_friction_alone():
    """From end to end; these runs found their integrator before, too: the test above is the one that guards it."""
    env = KeyCLDEnv("pendulum", obs_type="state", effects=[CoulombFriction("hinge", 1.68)])
    form, rng, runs = recordings("pendulum", 0, number=1, seconds=0.5)[0], np.random.default_rng(1), []
    t = 0.02 * np.arange(200)
    for run in range(8):
        env.reset(seed=run)
        u = np.repeat(rng.uniform(-3, 3, (len(t) // 20, 1)), 20, axis=0)
        q = np.array([env.step(a)[4]["qpos"] for a in u]) + rng.normal(0, 5e-4, (len(t), 1))
        runs.append(replace(form, id=str(run), t_action=t - 0.02, action=u, t_state=t, qpos=q))
    report = diagnose(runs, KeyCLDEnv("pendulum", obs_type="state").model)
    (finding,) = report.findings
    assert finding.effect == "coulomb_friction" and finding.confidence > 0.8
    assert finding.parameters["c"].value == pytest.approx(1.68, rel=0.01)
