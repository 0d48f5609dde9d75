"""Searches that would end in the wrong optimum."""

from dataclasses import replace

import numpy as np
from plants import recordings

from keycld_envs import KeyCLDEnv
from keycld_envs.effects import EFFECTS, Backlash
from keycld_model.diagnosis.fit import Problem
from keycld_model.diagnosis.search import Search
from keycld_model.diagnosis.simulator import Simulator
from keycld_model.diagnosis.windows import cut


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
    far = start.with_effects(Backlash("slide", j=0.005, g=0.09))
    others = {kind.id for kind in EFFECTS.values()} - {Backlash.id}
    best = Search(problem, others).run(start, far.variant.effects)
    found = next(e for e in best.fit.effects if e.where == "slide")
    assert isinstance(found, Backlash)
    assert np.isclose(found.j * found.g, truth.j * truth.g, rtol=0.2)
    assert best.fit.cost < problem.minimise(far, 40).cost - 100


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
