"""Contract of all effects."""

import mujoco
import numpy as np
import pytest

from keycld_envs.effects import (
    EFFECTS,
    ActuatorDelay,
    ActuatorLag,
    AddedInertia,
    AddedMass,
    AsymmetricFriction,
    Backlash,
    BaseMotion,
    CoulombFriction,
    GearFriction,
    HystereticFriction,
    JointFlexibility,
    LoadDependentFriction,
    MassDrift,
    SensorLatency,
)
from keycld_envs.effects.added_physics import AddedPhysics
from keycld_envs.effects.base_motion import weight
from keycld_envs.systems import REFERENCE_SYSTEMS, SYSTEMS

CASES = [(effect, system) for effect in EFFECTS.values() if effect is not GearFriction for system in REFERENCE_SYSTEMS]
"""Reference systems are driven by torques; gears are tested on a servo, tests/benchmarks/test_owners.py."""


def one_step(model, effects):
    """Velocities after a little while, from rest elsewhere."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = 0.7, 1.5, 0.8
    for effect in effects:
        effect.edit(model)
        data.ctrl[:] = effect.command(model, np.linspace(0.2, 1.0, 5)[:, None] * data.ctrl, 0.01)[-1]
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
        changed = one_step(SYSTEMS[system].compile(), [present]) - one_step(SYSTEMS[system].compile(), [])
        assert np.abs(changed).max() > 1e-6


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_an_effect_says_how_it_is_compiled_named_and_confused(effect):
    names, ids = {p.name for p in effect.parameters()}, {kind.id for kind in EFFECTS.values()}
    assert effect.phrase.removeprefix("an ").removeprefix("a ").lower() in ("", effect.id.replace("_", " "))
    assert len(effect.memory_spread) == effect.memory
    assert {effect.limiting_case, effect.same_everywhere} <= {"", *ids} - {effect.id}
    if effect.confusable:
        group = [k for k in EFFECTS.values() if k.confusable and k.confusable.group == effect.confusable.group]
        assert len(group) > 1 and names.issuperset(effect.confusable.unit)
    for absent in effect.candidates(SYSTEMS["cartpole"].compile()):
        assert not absent.forces or effect.program, (
            "An effect that pushes is stepped slowly, by NumPy, without a program."
        )


@pytest.mark.parametrize("effect", [e for e in EFFECTS.values() if e.program], ids=lambda effect: effect.__name__)
def test_a_compiled_force_is_the_one_of_steps_by_hand(effect):
    """As far as the force on a joint says it: dry friction, the base and masses are compared along motions."""
    model, rng, h = SYSTEMS["cartpole"].compile(), np.random.default_rng(0), 0.01
    t, q, v, u = rng.uniform(0, 1, 7), *(rng.normal(0, 1, (7, n)) for n in (model.nv, model.nv, model.nu))
    for absent in effect.candidates(model):
        changes = {p.name: p.grid[0] if p.grid else p.absent + 5 * p.scale for p in effect.parameters()}
        present = absent.with_parameters(**changes)
        begun = present.begin(model, v)
        at, motor = present.slot(model)
        if present.kind not in ("joint", "actuator"):
            other = present.base_acceleration(t) if present.kind == "world" else present.mass_factor(t)
            assert other is not None and other.shape == t.shape
            continue
        torque = model.actuator_gear[motor, 0] * model.actuator_gainprm[motor, 0] * u[:, motor]
        memory = present.begin_compiled(v[:, at])
        np.testing.assert_array_equal(np.reshape(memory, (effect.memory, 7)).T, begun)
        force, after = present.compiled_force(memory, t, q[:, at], v[:, at], lambda torque=torque: torque, h)
        by_hand, remembered = present.advance(model, begun, t, q, v, u, h)
        assert np.count_nonzero(np.abs(by_hand).max(axis=0)) <= 1
        if present.has_dry_friction:
            assert force is None
        elif present.forces:
            np.testing.assert_allclose(force, by_hand[:, at], rtol=1e-12)
            np.testing.assert_allclose(np.reshape(after, (effect.memory, 7)).T, remembered, rtol=1e-12)
            steps = present.remembered(memory, v[:, at], torque, h)
            np.testing.assert_array_equal(np.reshape(steps, (effect.memory, 7)), np.reshape(after, (effect.memory, 7)))


def within_bounds(effect):
    return all(p.low <= getattr(effect, p.name) <= p.high for p in effect.parameters())


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_no_number_is_beyond_its_bounds(effect):
    for absent in effect.candidates(SYSTEMS["cartpole"].compile()):
        for size in (-1e9, 0.0, 1e9):
            assert within_bounds(absent.with_parameters(**{p.name: size for p in effect.parameters()}))
            assert within_bounds(absent.of_size(size))


def test_a_sensor_ahead_of_time_is_confused_with_no_late_motor():
    model = SYSTEMS["acrobot"].compile()
    others = [place for kind in EFFECTS.values() for place in kind.candidates(model)]
    late = list(SensorLatency(d=0.01).confusable_with(others, model))
    assert {type(e) for e in late} == {ActuatorDelay, ActuatorLag}
    assert all(e.size == 0.01 and within_bounds(e) for e in late)
    assert not list(SensorLatency(d=-0.01).confusable_with(others, model))
    assert ActuatorDelay(late[0].where).of_size(-0.01).d == 0.0


def test_dry_friction_is_confused_at_its_own_joint_and_with_a_load_on_rails_only():
    for system, joint, rails in (("cartpole", "hinge_1", True), ("acrobot", "elbow", False)):
        model = SYSTEMS[system].compile()
        others = [place for kind in EFFECTS.values() for place in kind.candidates(model)]
        found = list(CoulombFriction(joint, c=0.3).confusable_with([*others, *others], model))
        assert {e.where for e in found} == {joint} and all(e.size == pytest.approx(0.3) for e in found)
        assert (
            len(found) == len({e.key for e in found})
            and any(e.confusable.on_rails for e in found if e.confusable) == rails
        )


def test_the_taxonomy_names_them():
    drifts = dict.fromkeys(("friction_drift", "gain_drift", "mass_drift"), "parameter_drift")
    shared: dict[str, str] = {**drifts, "added_mass": "added_inertia", "gear_friction": "load_dependent_friction"}
    assert all(effect.id == shared.get(name, name) for name, effect in EFFECTS.items())
    assert len({(effect.id, effect.kind) for effect in EFFECTS.values()}) == len(EFFECTS)


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


def swing(model, effects, q, v, seconds, u=0.0, h=None):
    """Positions and velocities at the steps, with effects as an environment applies them."""
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.timestep = h or 0.001
    physics, data, out = AddedPhysics(effects, model), mujoco.MjData(model), []
    physics.reset()
    data.qpos[:], data.qvel[:] = q, v
    for _ in range(round(seconds / model.opt.timestep)):
        data.ctrl[:] = u
        for _ in physics.steps(data, 1):
            mujoco.mj_step(model, data)
        out.append([*data.qpos, *data.qvel])
    return np.array(out)


def energy(model, state):
    """Kinetic and potential energy, J."""
    data, out = mujoco.MjData(model), []
    model.opt.enableflags = int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    for row in state:
        data.qpos[:], data.qvel[:] = np.split(row, 2)
        mujoco.mj_forward(model, data)
        out.append(data.energy.sum())
    return np.array(out)


def test_bristles_hold_like_a_spring_and_slide_like_dry_friction():
    model, friction = SYSTEMS["pendulum"].compile(), HystereticFriction("hinge", c=0.3, s=20.0)
    memory, q = np.zeros(1), np.zeros(1)
    held, memory = friction.advance(model, memory, np.zeros(()), q, np.array([0.001]), np.zeros(1), 0.1)
    assert held[0] == pytest.approx(-20 * 0.001 * 0.1 / 2, rel=1e-2)  # mean of a spring stretched from zero
    for _ in range(50):
        slid, memory = friction.advance(model, memory, np.zeros(()), q, np.array([1.0]), np.zeros(1), 0.01)
    assert slid[0] == pytest.approx(-0.3, rel=1e-3)


def test_bristles_that_hold_far_more_at_rest_do_not_begin_there():
    """Which recordings that are never slow do not contradict: they would be bent by 150 rad."""
    model = SYSTEMS["pendulum"].compile()
    friction = HystereticFriction("hinge", c=0.3, extra=150.0, s=1.0, vs=0.02)
    speeds = np.array([[1e-3], [-1e-3], [2.0]])
    assert friction.begin(model, speeds).ravel() == pytest.approx([0.3, -0.3, 0.3])
    (compiled,) = friction.begin_compiled(speeds[:, 0])
    assert np.asarray(compiled) == pytest.approx([0.3, -0.3, 0.3])


def test_inside_the_gap_nothing_reaches_the_joint():
    model = SYSTEMS["pendulum"].compile()
    free = swing(model, [Backlash("torque", j=0.01, g=0.5)], 0.3 + np.pi, 0.0, 0.05, u=1.0)
    alone = swing(SYSTEMS["pendulum"].compile(), [], 0.3 + np.pi, 0.0, 0.05)
    np.testing.assert_allclose(free, alone, atol=1e-9)
    later = swing(SYSTEMS["pendulum"].compile(), [Backlash("torque", j=0.01, g=0.5)], np.pi, 0.0, 1.0, u=1.0)
    assert np.abs(later - swing(SYSTEMS["pendulum"].compile(), [], np.pi, 0.0, 1.0)).max() > 0.1


def test_a_shaft_passes_the_mean_torque_on():
    """A rotor on a stiff shaft is an added inertia."""
    shaft = swing(SYSTEMS["pendulum"].compile(), [JointFlexibility("torque", j=0.05, k=300.0)], np.pi, 0.0, 1.0, u=1.0)
    rotor = swing(SYSTEMS["pendulum"].compile(), [AddedInertia("hinge", i=0.05)], np.pi, 0.0, 1.0, u=1.0)
    none = swing(SYSTEMS["pendulum"].compile(), [], np.pi, 0.0, 1.0, u=1.0)
    assert np.abs(shaft - rotor)[:, 0].max() < 0.03 * np.abs(none - rotor)[:, 0].max() + 2e-3


def test_the_load_of_a_bearing_is_weight_and_centrifugal_force():
    model = SYSTEMS["pendulum"].compile()
    data = mujoco.MjData(model)
    data.qpos[:] = np.pi
    mujoco.mj_forward(model, data)
    body = model.body("pole").id
    mass, arm = model.body_subtreemass[body], np.linalg.norm(data.subtree_com[body] - data.xpos[body])
    force = LoadDependentFriction("hinge", mu=0.01).force(
        model, np.zeros(()), np.array([np.pi]), np.array([2.0]), np.zeros(1)
    )
    assert force[0] == pytest.approx(-0.01 * mass * (9.81 + 4.0 * arm), rel=1e-6)


@pytest.mark.parametrize("system", REFERENCE_SYSTEMS)
def test_an_accelerated_base_is_tilted_gravity(system):
    model, moved = (SYSTEMS[system].compile() for _ in range(2))
    moved.opt.gravity[0] -= 0.7
    q, v = np.linspace(0.3, 1.1, model.nv), np.linspace(-1, 1, model.nv)
    data, other = mujoco.MjData(model), mujoco.MjData(moved)
    for m, d in ((model, data), (moved, other)):
        d.qpos[:], d.qvel[:] = q, v
        if m is model:
            d.qfrc_applied[:] = BaseMotion("x", b=0.7, w=3.0).force(model, np.zeros(()), q, v, np.zeros(model.nu))
        mujoco.mj_forward(m, d)
    np.testing.assert_allclose(data.qacc, other.qacc, atol=1e-9)


def test_what_leaks_accelerates_as_its_lighter_self():
    model, lighter = (SYSTEMS["acrobot"].compile() for _ in range(2))
    lighter.body_mass[2] *= 0.8
    lighter.body_inertia[2] *= 0.8
    q, v = np.array([0.4, 1.0]), np.array([1.0, -2.0])
    data, other = mujoco.MjData(model), mujoco.MjData(lighter)
    drift = MassDrift(model.body(2).name, r=-0.1)
    for m, d in ((model, data), (lighter, other)):
        d.qpos[:], d.qvel[:] = q, v
        if m is model:
            d.qfrc_applied[:] = drift.force(model, np.array(2.0), q, v, np.zeros(model.nu))
        mujoco.mj_forward(m, d)
    np.testing.assert_allclose(data.qacc, other.qacc, atol=1e-9)
    assert model.body_mass[2] == lighter.body_mass[2] / 0.8


@pytest.mark.parametrize(
    "effect", [HystereticFriction("elbow", c=0.2, s=10.0), LoadDependentFriction("elbow", mu=0.02)]
)
def test_friction_with_a_past_or_a_load_takes_energy(effect):
    state = swing(SYSTEMS["acrobot"].compile(), [effect], [1.0, 0.5], [0.0, 0.0], 3.0)
    e = energy(SYSTEMS["acrobot"].compile(), state[::50])
    assert e[-1] < e[0] - 0.1 and np.diff(e).max() < 0.05


@pytest.mark.parametrize("system", REFERENCE_SYSTEMS)
@pytest.mark.parametrize("axis", [0, 2])
def test_a_moving_base_pulls_as_gravity_does(system, axis):
    model, rng = SYSTEMS[system].compile(), np.random.default_rng(0)
    model.opt.gravity[:] = np.eye(3)[axis]
    data = mujoco.MjData(model)
    for _ in range(20):
        data.qpos[:] = rng.normal(0, 2, model.nq)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(weight(model, axis, data.qpos), -data.qfrc_bias, atol=1e-12)


ROD = """
<mujoco>
  <worldbody>
    <body name="rod"><joint name="pin" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02"/></body>
  </worldbody>
</mujoco>
"""


ON_A_ROD = [e for kind in EFFECTS.values() for e in kind.candidates(mujoco.MjModel.from_xml_string(ROD)) if e.forces]


def test_a_rod_without_a_motor_lacks_only_what_motors_do():
    model = mujoco.MjModel.from_xml_string(ROD)
    lacking = {name for name, kind in EFFECTS.items() if not kind.candidates(model)}
    assert lacking == {name for name, kind in EFFECTS.items() if kind.kind == "actuator"}


@pytest.mark.parametrize("absent", ON_A_ROD, ids=lambda effect: f"{effect.id}-{effect.where}")
def test_mechanisms_without_motors_have_effects_too(absent):
    model = mujoco.MjModel.from_xml_string(ROD)
    changes = {p.name: p.grid[0] if p.grid else p.absent + p.scale for p in absent.parameters()}
    present = type(absent)(absent.where, **changes)
    t, q, v = np.linspace(0, 1, 12).reshape(3, 4), np.full((3, 4, 1), 0.4), np.full((3, 4, 1), 1.5)
    force, _ = present.advance(model, present.begin(model, v), t, q, v, np.zeros((3, 4, 0)), 0.01)
    assert force.shape == v.shape and np.isfinite(force).all()


def test_a_mass_on_a_link_is_a_weight_fixed_to_it():
    """MuJoCo's own answer: the same model with a small heavy ball beyond the middle of the link."""
    xml = """<mujoco><worldbody><body name="link"><joint name="pivot" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.8" size="0.02" mass="1.2"/>{}</body></worldbody></mujoco>"""
    ball = '<body pos="0 0 -0.6"><geom type="sphere" size="0.001" mass="0.5"/></body>'
    edited, true = (mujoco.MjModel.from_xml_string(xml.format(x)) for x in ("", ball))
    AddedMass("link", m=0.5, x=1.5).edit(edited)
    answers = []
    for model in (edited, true):
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        data.qpos[:], data.qvel[:] = 0.7, 1.0
        mujoco.mj_forward(model, data)
        answers.append((data.qacc[0], data.qfrc_bias[0]))
    np.testing.assert_allclose(*answers, rtol=1e-5)
