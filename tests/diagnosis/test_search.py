"""Searches that would end in the wrong optimum."""

from contextlib import ExitStack
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock, patch

import numpy as np
from plants import recordings

from keycld_envs import KeyCLDEnv
from keycld_envs.effects import EFFECTS, ActuatorDelay, ActuatorLag, Backlash, SensorLatency
from keycld_model.diagnosis.estimation.fit import Problem
from keycld_model.diagnosis.estimation.pulses import spiked
from keycld_model.diagnosis.inputs.windows import cut
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


def test_play_is_found_from_numbers_far_off():
    truth = Backlash("slide", j=0.085, g=0.006)
    simulator = Simulator(KeyCLDEnv("cartpole", obs_type="state").model)
    problem = Problem(simulator, cut(loose(truth), simulator.step, 40), np.full(2, 3e-4))
    start = problem.minimise(problem.start()).point
    far = start.with_effects(Backlash("slide", j=0.3, g=0.0005))
    others = {kind.id for kind in EFFECTS.values()} - {Backlash.id}
    best = Search(problem, others).run(start, far.variant.effects)
    found = next(e for e in best.fit.effects if e.where == "slide")
    assert isinstance(found, Backlash)
    assert best.fit.cost < problem.minimise(far, 40).cost - 100
    # As good as from the truth, from which its numbers may differ: gap and contact stand for each other.
    assert best.fit.cost < problem.minimise(start.with_effects(truth), 40).cost + 30


def test_beside_strong_pushes_an_effect_must_gain_its_share_of_all():
    def friction(_t, _q, v, _u):
        return np.array([-0.02 * np.tanh(v[0] / 0.01)])

    runs = recordings("pendulum", 2, friction, number=4, seconds=2.0)
    simulator = Simulator(KeyCLDEnv("pendulum", obs_type="state").model)
    problem = Problem(simulator, cut(runs, simulator.step, 40), np.full(1, 1e-3))
    start = problem.minimise(problem.start())
    others = {kind.id for kind in EFFECTS.values()} - {"coulomb_friction"}
    alone = Search(problem, others).run(start.point)
    assert {effect.id for effect in alone.fit.effects} == {"coulomb_friction"}
    gain = start.cost - alone.fit.cost
    assert Search(problem, others, gained=20 * gain).run(start.point).keys == alone.keys
    assert not Search(problem, others, gained=200 * gain).run(start.point).keys


def test_a_set_without_its_filler_wins_when_it_turns_up_late():
    """It explains as much, to within what an effect must gain, and less than the next round must gain."""

    def scored(effects: str, score: float) -> SimpleNamespace:
        return SimpleNamespace(keys=frozenset(effects), size=(len(effects), len(effects)), score=score, fit=Mock())

    nothing, pair, single = scored("", 500.0), scored("ab", 100.0), scored("a", 96.4)
    rounds = iter([pair, single, single])
    search = Search.__new__(Search)
    search.gained = search._nothing = 0.0
    with ExitStack() as stack:
        for name, result in {
            "_refine": lambda point, **_: nothing if point is start else current[0],
            "_finalists": lambda best: [current.__setitem__(0, next(rounds)) or current[0]],
            "_pruned": lambda best: best,
            "_simplified": lambda best: best,
            "_exchanged": lambda best: best,
        }.items():
            stack.enter_context(patch.object(search, name, result))
        start, current = Mock(), [nothing]
        start.with_effects.return_value = start
        assert search.run(start) is single


def test_windows_that_stick_out_are_seen_where_all_together_look_like_noise():
    def fit(*above: float) -> Any:
        costs = np.full(80, 40.0)
        costs[: len(above)] += above
        problem = SimpleNamespace(costs=lambda point: costs, samples=6400, windows=range(80))
        return SimpleNamespace(problem=problem, point=None)

    assert not spiked(fit()) and not spiked(fit(200.0)) and not spiked(fit(19.0, 19.0, 19.0))
    assert spiked(fit(21.0, 22.0))


def test_no_effect_stands_twice_in_a_set():
    """A set without one of two of the same key had the same key as with both, so that pruning it never ended."""
    runs = recordings("pendulum", 3, number=3, seconds=1.2)
    simulator = Simulator(KeyCLDEnv("pendulum", obs_type="state").model, 0.01)
    problem = Problem(simulator, cut(runs, simulator.step, 40), np.full(1, 1e-3))
    search = Search(problem, {kind.id for kind in EFFECTS.values()} - {"actuator_lag", "actuator_delay"})
    late = ActuatorLag("torque", lag=0.02), ActuatorDelay("torque", d=0.02)
    best = search._refine(problem.start().with_effects(*late))
    with patch.object(search, "_refine", wraps=search._refine) as refine:
        for effect in best.fit.effects:
            search._replace(best, effect)
    tried = [[e.key for e in call.args[0].variant.effects] for call in refine.call_args_list]
    assert tried and all(len(keys) == len(set(keys)) for keys in tried)


def test_no_delay_of_motors_stands_in_for_sensors_that_are_ahead():
    """A negative latency has no rival among delays: it was copied into one, beyond its bounds, which ended a search."""
    ahead = []
    for run in recordings("cartpole", 3, number=3, seconds=1.2):
        assert run.qpos is not None and run.t_state is not None
        ahead.append(replace(run, qpos=run.qpos[1:], t_state=run.t_state[:-1]))
    simulator = Simulator(KeyCLDEnv("cartpole", obs_type="state").model, 0.01)
    problem = Problem(simulator, cut(ahead, simulator.step, 40), np.full(2, 1e-3))
    search = Search(problem, {kind.id for kind in EFFECTS.values()} - {"sensor_latency", "actuator_delay"})
    best = search.run(problem.start(), [SensorLatency(d=-0.005)])
    (effect,) = best.fit.effects
    assert isinstance(effect, SensorLatency) and effect.d < -0.005
    search.rivals(best)
    delays = [e for s in search.found.values() for e in s.fit.effects if isinstance(e, ActuatorDelay)]
    assert all(e.d >= 0 for e in delays)
