"""Concealed effects, against simulations that have them."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from keycld_envs import effects as e
from keycld_envs.conceal import conceal
from keycld_envs.effects.added_physics import AddedPhysics
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording

ARM = """
<mujoco>
  <option gravity="0 0 -9.81" timestep="0.001" integrator="RK4"><flag contact="disable"/></option>
  <worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.02"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".6"/>
    <body name="lower" pos="0 0 -.3"><joint name="elbow" axis="0 1 0" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".4"/></body></body></worldbody>
  <actuator><motor name="first" joint="shoulder" gear="2"/><motor name="second" joint="elbow"/></actuator>
</mujoco>
"""
STEP, SAMPLES = 0.005, 200
TIMES = np.linspace(0, STEP * (SAMPLES - 1), SAMPLES)


def commands() -> np.ndarray:
    t = TIMES
    u = np.stack([0.6 * np.sin(5 * t) + 0.2, 0.5 * np.cos(7 * t) - 0.3 * np.sin(3 * t)], axis=1)
    return u * (t >= 0.05)[:, None]  # delays have no past


def simulated(t_action: np.ndarray, action: np.ndarray, *added: e.Effect) -> np.ndarray:
    """Positions at every `STEP`, for commands that hold until the next."""
    model = mujoco.MjModel.from_xml_string(ARM)
    physics, data, out = AddedPhysics(added, model), mujoco.MjData(model), []
    physics.reset()
    data.qpos[:] = 0.5, -0.8
    for k in range(SAMPLES * 5):
        if k % 5 == 0:
            out.append(data.qpos.copy())
        held = max(int(np.searchsorted(t_action, data.time + 5e-4, "right")) - 1, 0)
        data.ctrl[:] = action[held]
        for _ in physics.steps(data, 1):
            mujoco.mj_step(model, data)
    return np.array(out)


@cache
def recorded() -> Recording:
    t, u = TIMES, commands()
    return Recording(
        id="run",
        source="simulation",
        joint_names=("shoulder", "elbow"),
        actuator_names=("first", "second"),
        units={"action": "1", "qpos": "rad"},
        t_action=t,
        action=u,
        t_state=t,
        qpos=simulated(t, u),
    )


@pytest.mark.parametrize(
    "effect",
    [
        e.ViscousFriction("elbow", b=0.05),
        e.QuadraticDrag("shoulder", d=0.02),
        e.CoulombFriction("elbow", c=0.1),
        e.StribeckFriction("shoulder", c=0.1, extra=0.1, vs=0.5),
        e.AsymmetricFriction("elbow", forward=0.15, backward=0.05),
        e.PositionDependentFriction("elbow", c=0.1, a=0.05, b=0.02),
        e.HystereticFriction("elbow", c=0.1, extra=0.05, s=20.0, vs=0.3),
        e.LoadDependentFriction("elbow", mu=0.01),
        e.Spring("shoulder", k=0.5, f=0.1),
        e.ConstantForce("elbow", f=0.1),
        e.Cogging("elbow", a=0.1, b=0.05, n=6.0),
        e.ExternalPeriodic("shoulder", a=0.2, b=0.1, w=8.0),
        e.ExternalPulse("elbow", f=0.4, start=0.6, duration=0.2),
        e.EndStop("elbow", at=-0.5, k=5.0),
        e.FrictionDrift("elbow", r=0.03),
        e.BaseMotion("x", a=0.5, b=0.2, w=5.0),
        e.GravityTilt(alpha=0.1),
        e.ActuatorGain("first", k=0.8),
        e.GainDrift("second", r=-0.1),
        e.ActuatorDeadZone("second", delta=0.1),
        e.ActuatorLag("first", lag=0.03),
        e.ActuatorDelay("second", d=0.02),
    ],
    ids=lambda effect: f"{type(effect).__name__} at {effect.where}",
)
def test_with_the_effect_the_simulation_is_right_and_without_it_wrong(effect):
    recording = recorded()
    concealed = conceal(recording, mujoco.MjModel.from_xml_string(ARM), effect)
    t, u = concealed.recording.t_action, concealed.recording.action
    assert t is not None and u is not None and recording.qpos is not None
    without, with_it = simulated(t, u), simulated(t, u, effect)
    wrong, right = (np.sqrt(np.mean((q - recording.qpos) ** 2)) for q in (without, with_it))
    assert wrong > 0.01
    assert right < 0.1 * wrong
    assert concealed.hidden.max() > 0.01


@pytest.mark.parametrize(("effect", "shift"), [(e.SensorLatency(d=0.03), 0.03), (e.ClockDrift(epsilon=0.01), 0.0)])
def test_clocks(effect, shift):
    recording = recorded()
    t = conceal(recording, mujoco.MjModel.from_xml_string(ARM), effect).recording.t_state
    assert t is not None and recording.t_state is not None
    np.testing.assert_allclose(effect.observe(t), recording.t_state, atol=1e-12)
    assert t[0] == pytest.approx(shift)


@pytest.mark.parametrize(
    "effect",
    [
        e.AddedMass("lower", m=0.1),
        e.AddedInertia("elbow", i=0.01),
        e.Backlash("second", j=0.01, g=0.05),
        e.ActuatorSaturation("second", s=0.1),
    ],
    ids=lambda effect: effect.id,
)
def test_what_no_command_can_conceal_is_refused(effect):
    with pytest.raises(InputError, match=effect.id):
        conceal(recorded(), mujoco.MjModel.from_xml_string(ARM), effect)


def test_in_commands_that_are_zero_nothing_is_concealed():
    recording = recorded()
    assert recording.action is not None
    still = replace(recording, action=np.zeros_like(recording.action))
    model = mujoco.MjModel.from_xml_string(ARM)
    for delta in (0.1, 30.0):
        concealed = conceal(still, model, e.ActuatorDeadZone("second", delta=delta))
        assert concealed.recording.action is not None
        assert not concealed.hidden.any() and not concealed.recording.action.any()


def test_a_motor_that_pulls_two_joints_by_a_tendon():
    tendon = '<tendon><fixed name="belt"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-.5"/></fixed>'
    xml = ARM.replace("<actuator>", f"{tendon}</tendon><actuator>").replace('joint="elbow"/>', 'tendon="belt"/>', 1)
    assert '"second" tendon="belt"' in xml
    hidden = conceal(recorded(), mujoco.MjModel.from_xml_string(xml), e.ActuatorGain("second", k=0.5)).hidden
    assert hidden[1] == pytest.approx(hidden[0] / 2) and hidden[1] > 0


def test_joints_without_motors_are_refused():
    xml = ARM.replace('<motor name="first" joint="shoulder" gear="2"/>', "")
    model, recording = mujoco.MjModel.from_xml_string(xml), recorded()
    assert recording.action is not None
    passive = replace(recording, action=recording.action[:, 1:], actuator_names=("second",))
    with pytest.raises(InputError, match="'shoulder', which has no motor"):
        conceal(passive, model, e.ViscousFriction("shoulder", b=0.1))
    assert conceal(passive, model, e.ViscousFriction("elbow", b=0.1)).hidden[1] > 0


@pytest.mark.parametrize(
    "change, named",
    [
        ({"qpos": np.zeros((5, 2)), "t_state": TIMES[:5]}, "10"),
        ({"qpos": np.zeros((SAMPLES, 3)), "joint_names": ("a", "b", "c")}, "3 joints"),
        ({"action": None, "t_action": None}, "viscous_friction"),
        ({"action": np.zeros((SAMPLES, 3)), "actuator_names": ("a", "b", "c")}, "3 actions"),
    ],
)
def test_recordings_that_do_not_suit_are_refused(change, named):
    with pytest.raises(InputError, match=named):
        conceal(replace(recorded(), **change), mujoco.MjModel.from_xml_string(ARM), e.ViscousFriction("elbow", b=0.1))


def test_measured_speeds_are_taken_for_speeds():
    """A recording that says it moved twice as fast hides twice the friction."""
    model, recording, friction = mujoco.MjModel.from_xml_string(ARM), recorded(), e.ViscousFriction("elbow", b=0.1)
    speeds = np.gradient(np.asarray(recording.qpos), TIMES, axis=0)
    units = {**recording.units, "qvel": "rad/s"}
    measured = [replace(recording, qvel=k * speeds, units=units) for k in (1, 2)]
    once, twice = (conceal(r, model, friction).hidden[1] for r in measured)
    assert once == pytest.approx(0.1 * np.sqrt(np.mean(speeds[:, 1] ** 2)), rel=0.01)
    assert twice == pytest.approx(2 * once)
