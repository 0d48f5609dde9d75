"""Contract of all effects."""

import mujoco
import numpy as np
import pytest

from keycld_envs.effects import EFFECTS, AsymmetricFriction, CoulombFriction
from keycld_envs.systems import SYSTEMS

CASES = [(effect, system) for effect in EFFECTS.values() for system in ("pendulum", "cartpole", "acrobot")]


def one_step(model, effects):
    """Velocities after a little while, from rest elsewhere."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = 0.7, 1.5, 0.8
    for effect in effects:
        effect.edit(model)
        data.ctrl[:] = effect.command(model, np.repeat(data.ctrl[None], 5, axis=0), 0.01)[-1]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for effect in effects:
        memory = effect.begin(model, data.qvel)
        state = data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()
        data.qfrc_applied[:] += effect.advance(model, memory, np.array(0.05), *state, 0.01)[0]
    mujoco.mj_step(model, data)
    times = np.array([0.5])
    for effect in effects:
        times = effect.observe(times)
    return np.concatenate([data.qvel, times])


@pytest.mark.parametrize("effect, system", CASES, ids=lambda case: getattr(case, "id", case))
def test_an_effect_names_its_place_and_does_something_only_if_present(effect, system):
    model = SYSTEMS[system].compile()
    found = effect.candidates(model)
    assert found
    for absent in found:
        assert absent.id in str(absent) and absent.where in str(absent) and effect.family
        coefficients = [p for p in effect.parameters() if not p.grid]
        for p in coefficients:
            assert p.low <= getattr(absent, p.name) <= p.high
        if coefficients:
            np.testing.assert_array_equal(
                one_step(SYSTEMS[system].compile(), []), one_step(SYSTEMS[system].compile(), [absent])
            )
        changes = {p.name: p.absent + 5 * p.scale for p in coefficients}
        changes |= {p.name: p.grid[0] for p in effect.parameters() if p.grid}
        present = type(absent)(absent.where, **changes)
        if effect.id not in ("actuator_lag", "actuator_delay", "end_stop", "external_pulse"):  # need a past, or a pose
            changed = one_step(SYSTEMS[system].compile(), [present]) - one_step(SYSTEMS[system].compile(), [])
            assert np.abs(changed).max() > 1e-6


def test_the_taxonomy_names_them():
    assert all(name == effect.id == effect.__module__.rsplit(".", 1)[1] for name, effect in EFFECTS.items())


def test_dry_friction_holds_the_acrobot_too():
    """dm_control switches constraints off there, and with them dry friction."""
    model = SYSTEMS["acrobot"].compile()
    CoulombFriction("shoulder", c=50.0).edit(model)
    data = mujoco.MjData(model)
    data.qpos[:] = 1.0, 0.0
    for _ in range(100):
        mujoco.mj_step(model, data)
    assert abs(data.qpos[0] - 1.0) < 0.05 < abs(data.qpos[1])


def test_asymmetric_friction_brakes_more_in_one_direction():
    friction = AsymmetricFriction("hinge", forward=0.3, backward=0.1)
    model = SYSTEMS["pendulum"].compile()
    friction.edit(model)
    forward, backward = (
        model.dof_frictionloss[0] - s * friction.force(model, np.zeros(()), np.zeros(1), np.array([s]), np.zeros(1))[0]
        for s in (1.0, -1.0)
    )
    assert (forward, backward) == pytest.approx((0.3, 0.1))


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.013, 0.02])
def test_delay_and_lag_conserve_impulse(delay):
    model, h = SYSTEMS["pendulum"].compile(), 0.01
    u = np.concatenate([np.zeros((3, 1)), np.ones((5, 1)), np.zeros((60, 1))])
    for name, value in (("actuator_delay", "d"), ("actuator_lag", "lag")):
        got = EFFECTS[name]("torque", **{value: delay}).command(model, u, h)
        assert got.sum() == pytest.approx(5, abs=1e-3)
        centre = (got[:, 0] * np.arange(len(u))).sum() / got.sum()
        assert centre * h == pytest.approx(5 * h + delay, abs=1e-4)
