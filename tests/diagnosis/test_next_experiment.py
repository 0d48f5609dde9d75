"""The recording to make next tells rivals apart, which the recordings so far do not."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from plants import problem_of, recordings, windows_of

from keycld_envs.effects import ConstantForce, Spring
from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.output.words import experiment
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.drive import Drive
from keycld_model.diagnosis.verdict.next_experiment import FASTEST, next_experiment
from keycld_model.diagnosis.verdict.report import Experiment

STIFFNESS = 0.4


@pytest.fixture(scope="module")
def swings() -> list[Recording]:
    """A pendulum with a spring, which hardly moves."""
    model = get_system("pendulum").compile()
    data, out = mujoco.MjData(model), []
    model.opt.timestep, model.opt.integrator = 0.01, mujoco.mjtIntegrator.mjINT_RK4
    for run in recordings("pendulum", 3, number=3, seconds=2.0):
        mujoco.mj_resetData(model, data)
        data.qpos[:], q = np.pi + 0.02, []
        for _ in range(len(np.asarray(run.qpos))):
            q.append(data.qpos.copy())
            data.qfrc_applied[:] = -STIFFNESS * (data.qpos - 2.5)
            mujoco.mj_step(model, data)
        noise = np.random.default_rng(int(run.id[-1])).normal(0, 1e-3, (len(q), 1))
        out.append(replace(run, qpos=np.array(q) + noise, action=np.zeros_like(run.action)))
    return out


@pytest.fixture(scope="module")
def fits(swings) -> tuple[Fit, Fit]:
    simulator = Simulator(get_system("pendulum").compile(), 0.01)
    problem = problem_of(simulator, swings)
    start = problem.start()
    spring, force = Spring("hinge", k=STIFFNESS, f=2.5 * STIFFNESS), ConstantForce("hinge", f=-0.2)
    return minimise(problem, start.with_effects(spring)), minimise(problem, start.with_effects(force))


def test_a_spring_is_told_from_a_force_by_a_motion_that_tells_them(swings, fits):
    spring, force = fits
    proposed = next_experiment(spring, [("constant_force", force)], 80)
    assert proposed is not None and proposed.decisive and proposed.against == ["constant_force"]
    simulator, window = spring.problem.simulator, swings[0]
    start = np.array([proposed.start["hinge"]])
    assert abs(start[0] - np.pi) > 0.2 or "drive" in proposed.action
    assert (proposed.where["kind"] == "joint") == (proposed.drive.shape == "none")
    if proposed.where["kind"] == "joint":  # done for real, the rival leaves as much as was said, within the noise
        still = replace(window, t_state=0.01 * np.arange(80), qpos=np.repeat(start[None], 80, axis=0))
        q, v = start[None], np.zeros((1, 1))
        made = replace(spring.problem, windows=windows_of([still], simulator.model, samples=80))
        motion = made.predicted(replace(spring.point, q=q, v=v))
        made = replace(made, windows=replace(made.windows, measured=motion))
        costs = [minimise(made, replace(f.point, q=q, v=v), only_states=True).cost for f in fits]
        assert costs[1] - costs[0] >= 0.5 * proposed.nats
        assert np.abs(np.diff(motion[0], axis=0) / 0.01).max() < FASTEST


def test_of_the_same_nothing_is_told_apart_and_the_words_say_so(swings, fits):
    proposed = next_experiment(fits[0], [("spring", fits[0])], 80)
    assert proposed is not None and (proposed.nats, proposed.decisive) == (0.0, False)
    assert "a spring" in experiment(proposed) and "Measure something else" in experiment(proposed)


@pytest.mark.slow
@pytest.mark.parametrize("loop", [False, True])
def test_slides_are_released_and_where_nothing_can_be_done_nothing_is_proposed(loop):
    closed = '<equality><joint joint1="x" joint2="y"/></equality>' if loop else ""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option gravity="0 0 0"/><default><geom size=".1" contype="0" conaffinity="0"/>'
        '<joint type="slide" axis="1 0 0"/></default><worldbody>'
        '<body name="a"><joint name="x" stiffness="5"/><geom/></body>'
        f'<body name="b"><joint name="y"/><geom/></body></worldbody>{closed}</mujoco>'
    )
    t = 0.01 * np.arange(80, dtype=np.float64)
    still = Recording(
        id="0", source="simulation", joint_names=("x", "y"), units={"qpos": "m"}, t_state=t, qpos=np.zeros((80, 2))
    )  # fmt: skip
    problem = problem_of(Simulator(model, 0.01), [still])
    nothing = minimise(problem, problem.start(), 1)
    spring = replace(nothing, point=nothing.point.with_effects(Spring("x", k=20.0, f=0.0)))
    proposed = next_experiment(spring, [("nothing", nothing)], 80)
    if loop:
        assert proposed is None
    else:
        assert proposed is not None and proposed.decisive and proposed.where == {"kind": "joint", "name": "x"}
        assert proposed.action.startswith("release it 0.5 m from rest")


def test_commands_of_a_drive():
    time = 0.01 * np.arange(200, dtype=np.float64)
    sine, steps = Drive("sine", 1.5, 2.0), Drive("steps", 0.5, 2.5)
    assert sine.commands(time) == pytest.approx(1.5 * np.sin(4 * np.pi * time))
    told = steps.commands(time).reshape(5, 40)  # .4 s each
    assert (np.ptp(told, axis=1) == 0).all() and len(set(told[:, 0])) == 5 and np.abs(told).max() <= 0.5
    assert np.array_equal(steps.commands(time[:80]), told[:2].ravel())
    assert not Drive().commands(time).any()
    assert [str(each) for each in (sine, steps)] == ["a sine of 2 Hz up to 1.5", "random steps every 0.4 s up to 0.5"]


def test_words_of_a_proposal():
    proposed = Experiment(
        {"kind": "actuator", "name": "elbow"},
        "drive it with a sine of 2 Hz up to 1.5, for 1.6 s",
        {"shoulder": 3.1416, "elbow": 0.0},
        ["coulomb_friction", "nothing"],
        41.6,
        True,
    )
    words = experiment(proposed)
    for part in (
        "Coulomb friction and nothing",
        "drive actuator elbow",
        "a sine of 2 Hz",
        "shoulder 3.14",
        "elbow 0",
        "42 nats",
    ):
        assert part in words, part
