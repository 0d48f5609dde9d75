"""Simulators as models of joints: torques, and rollouts, with effects of joints and motors."""

import numpy as np
import pytest

from keycld_control.delan.real import beginning
from keycld_control.delan.simulators import Simulated
from keycld_envs.effects import (
    ActuatorDelay,
    ActuatorGain,
    CoulombFriction,
    Effect,
    QuadraticDrag,
    Spring,
    ViscousFriction,
)
from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system

ACROBOT = get_system("acrobot").compile()
OFFSET = np.array([0.02, -0.01])
EFFECTS: tuple[Effect, ...] = (
    ViscousFriction("shoulder", 0.2),
    CoulombFriction("elbow", 0.1),
    QuadraticDrag("elbow", 0.03),
    Spring("shoulder", k=0.3, f=0.05),
    ActuatorGain("elbow", 0.8),
)


def motion(n: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = 0.01 * np.arange(n)[:, None]
    size, w, phase = np.array([0.8, 0.5]), np.array([3.0, 5.0]), np.array([0.3, 1.0])
    q = size * np.sin(w * t + phase)
    return q, size * w * np.cos(w * t + phase), -(w**2) * q


def test_torques_are_those_of_the_simulator_and_of_what_acts_beside() -> None:
    q, v, a = motion()
    bare = Simulated(ACROBOT, (), OFFSET).inverse_dynamics(q, v, a)
    found = Simulated(ACROBOT, EFFECTS, OFFSET).inverse_dynamics(q, v, a)
    shoulder = bare[:, 0] + 0.2 * v[:, 0] + 0.3 * (q - OFFSET)[:, 0] - 0.05
    elbow = (bare[:, 1] + 0.1 * np.tanh(v[:, 1] / 1e-3) + 0.03 * v[:, 1] * np.abs(v[:, 1])) / 0.8
    moves = np.abs(v[:, 1]) > 0.05
    np.testing.assert_allclose(found[:, 0], shoulder, atol=1e-3)
    np.testing.assert_allclose(found[moves, 1], elbow[moves], atol=2e-3)


def test_a_rollout_under_the_torques_of_a_motion_is_the_motion() -> None:
    q, v, a = motion(80)
    model = Simulated(ACROBOT, EFFECTS, OFFSET)
    path, speed = model.rollout(q[0], v[0], model.inverse_dynamics(q, v, a), 0.01)
    assert path.shape == speed.shape == q.shape
    assert np.abs(path - q).max() < 0.02
    other, _ = Simulated(ACROBOT, (), OFFSET).rollout(q[0], v[0], model.inverse_dynamics(q, v, a), 0.01)
    assert np.abs(other - q).max() > 0.1


def test_dry_friction_holds_and_a_delay_delays() -> None:
    pendulum, still = get_system("pendulum").compile(), np.array([0.3])
    stuck, _ = Simulated(pendulum, (CoulombFriction("hinge", 50.0),)).rollout(still, 0 * still, np.zeros((40, 1)), 0.02)
    np.testing.assert_allclose(stuck, 0.3, atol=1e-6)
    push = np.where(np.arange(40) < 20, 0.0, 3.0)[:, None]
    paths = [
        Simulated(pendulum, e).rollout(still, 0 * still, push, 0.02)[0] for e in ((), (ActuatorDelay("torque", 0.06),))
    ]
    begins = [
        np.flatnonzero(np.abs(p - Simulated(pendulum).rollout(still, 0 * still, 0 * push, 0.02)[0]) > 1e-4)[0]
        for p in paths
    ]
    assert begins[1] - begins[0] == pytest.approx(3, abs=1)


def test_a_beginning_has_a_share_of_the_time() -> None:
    t = np.linspace(5.0, 9.0, 101)
    whole = Recording(
        id="a",
        source="real",
        joint_names=("hinge",),
        actuator_names=("motor",),
        units={"qpos": "rad", "qvel": "rad/s", "action": "N m"},
        t_state=t,
        qpos=t[:, None],
        qvel=t[:, None],
        t_action=t[::2],
        action=t[::2, None],
    )
    part = beginning(whole, 0.25)
    assert part.t_state is not None and part.t_action is not None
    assert part.t_state[-1] == 6.0 and part.t_action[-1] <= 6.0
    assert np.array_equal(np.asarray(part.qpos), np.asarray(part.qvel)) and len(part.t_action) == 13
