"""Compiled rollouts against MuJoCo's."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from plants import problem_of, recordings, windows_of

from keycld_envs.effects import EFFECTS, Effect
from keycld_envs.effects.added_physics import AddedPhysics
from keycld_envs.effects.places import add_friction
from keycld_envs.systems import REFERENCE_SYSTEMS, get_system
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.simulation.variant import Variant
from keycld_model.rigid_body.compiled import CompiledEngine
from keycld_model.rigid_body.effects import AppliedEffects
from keycld_model.rigid_body.engine import Copies, MujocoEngine

SKEW = """
<mujoco>
  <option gravity="1 -2 -9" timestep="0.005"><flag contact="disable"/></option>
  <default><geom density="700"/></default>
  <worldbody>
    <body name="car" pos="0.1 0.2 0.3" quat="0.9 0.1 0.3 -0.2">
      <joint name="rail" type="slide" axis="1 2 0.5" damping="0.3" stiffness="2" springref="0.1" ref="0.05"/>
      <geom type="box" size="0.1 0.05 0.03" pos="0.02 0.01 0" euler="10 20 30"/>
      <body name="mast" pos="0 0.1 0" euler="40 -10 20">
        <joint name="yaw" axis="0 0 1" pos="0.03 0 0.1" armature="0.02" ref="0.3"/>
        <joint name="pitch" axis="0.3 1 0" frictionloss="0.2"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 0.4" size="0.04"/>
        <body pos="0.1 0 0.4"><geom type="sphere" size="0.06" pos="0 0.05 0"/></body>
        <body name="tip" pos="0.1 0 0.4">
          <joint name="wrist" axis="1 0 0" frictionloss="0.05" damping="0.01"/>
          <geom type="ellipsoid" size="0.03 0.1 0.05" pos="0 0.1 0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="yaw" gear="2" ctrlrange="-1 1" ctrllimited="true"/>
    <general joint="rail" gainprm="3" biastype="affine" biasprm="0.1 -0.5 0" forcerange="-4 4" forcelimited="true"/>
  </actuator>
</mujoco>
"""


LOOPS = """
<mujoco>
  <option gravity="1 -2 -9" timestep="0.002"><flag contact="disable"/></option>
  <worldbody>
    <site name="pivot" pos="0.5 0 0.3"/>
    <body name="crank"><joint name="crank" axis="0 1 0" damping="0.01"/>
      <geom type="capsule" fromto="0 0 0 0.15 0 0" size="0.02"/>
      <body name="rod" pos="0.15 0 0"><joint name="rod" axis="0 1 0" frictionloss="0.05"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.015"/><site name="middle" pos="0.2 0 0.02"/></body></body>
    <body name="slider" pos="0.55 0 0"><joint name="slider" type="slide" axis="1 0 0" frictionloss="0.3"/>
      <geom type="box" size="0.03 0.03 0.03"/></body>
    <body name="arm" pos="0.5 0 0.3" euler="0 20 0"><joint name="arm" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0.1" size="0.02"/></body>
    <body name="wheel" pos="0 0 1"><joint name="wheel" axis="0 1 0" ref="0.2"/>
      <geom type="cylinder" size="0.1 0.02"/></body>
  </worldbody>
  <equality>
    <connect body1="rod" body2="slider" anchor="0.4 0 0"/>
    <joint joint1="wheel" joint2="arm" polycoef="0.1 1.5 0.2 0 0.01" solimp="0.8 0.99 0.02 0.3 3" solref="0.03 0.7"/>
    <joint joint1="arm" solref="0.05 1" solimp="0.5 0.5 0.001"/>
    <connect site1="middle" site2="pivot" solref="0.1 0.5" solimp="0.2 0.6 0.3 0.4 1.5"/>
  </equality>
  <actuator><motor joint="crank" gear="2"/></actuator>
</mujoco>
"""


OWN = "skew", "passive", "loops"


def model_of(name: str) -> mujoco.MjModel:
    if name in ("skew", "passive"):
        xml = SKEW if name == "skew" else SKEW.split("<actuator>")[0] + "</mujoco>"
        return mujoco.MjModel.from_xml_string(xml)
    if name == "loops":
        return mujoco.MjModel.from_xml_string(LOOPS)
    return get_system(name).compile()


def rub(model: mujoco.MjModel) -> None:
    for dof in range(model.nv):
        add_friction(model, dof, 0.1 + 0.1 * dof)


def swing(model: mujoco.MjModel) -> None:
    model.dof_dampingpoly[:] = 0.05, 0.01
    model.jnt_stiffnesspoly[:] = 0.1, 0.02
    model.body_mass[1:] *= 1.2
    model.body_ipos[1:] *= 0.9


@pytest.mark.parametrize("integrator", ["mjINT_EULER", "mjINT_RK4", "mjINT_IMPLICITFAST"])
@pytest.mark.parametrize("name", [*REFERENCE_SYSTEMS, *(pytest.param(n, marks=pytest.mark.long) for n in OWN)])
def test_every_step_is_that_of_mujoco(name, integrator):
    base, rng = model_of(name), np.random.default_rng(0)
    base.opt.integrator = getattr(mujoco.mjtIntegrator, integrator)
    base.jnt_limited[:] = 0
    base.opt.tolerance, base.opt.iterations = 1e-14, 200
    models = []
    for change in (lambda model: None, swing, rub):
        model = model_of(name)
        model.opt.timestep, model.opt.integrator = base.opt.timestep, base.opt.integrator
        model.opt.tolerance, model.opt.iterations = 1e-14, 200
        model.jnt_limited[:] = 0
        change(model)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        models.append(model)
    mechanism = CompiledEngine.of(base)
    assert mechanism is not None
    number, steps = 300, 40
    of = np.arange(number) % len(models)
    state = np.concatenate([rng.normal(0, 1, (number, base.nv)), rng.normal(0, 2, (number, base.nv))], axis=1)
    if name == "loops":  # nearly closed
        state *= 0.02
    control = rng.normal(0, 1, (number, steps, base.nu + base.nv))
    slow = MujocoEngine(base, 2)
    full = np.zeros((number, slow.size))
    full[:, slow.motion] = state
    copies = Copies(models, [AppliedEffects()] * len(models), of, np.zeros(number, int))
    true = slow.run(slow.batch(copies), full, control, np.zeros(number))[..., slow.motion]
    path = mechanism.run(mechanism.batch(copies), state, control, np.zeros(number))
    free = of < 2
    assert path[free] == pytest.approx(true[free], abs=1e-9)
    assert np.max(np.abs(path[~free] - true[~free])) < 1e-6


@pytest.mark.parametrize("name", [*REFERENCE_SYSTEMS, pytest.param("skew", marks=pytest.mark.long)])
def test_friction_that_stops_is_that_of_a_hundred_steps_with_a_stiff_constraint(name):
    """In steps of a hundredth of the time MuJoCo's constraint can be so stiff that it hardly creeps."""
    rng, step, fine, number, steps = np.random.default_rng(0), 0.005, 100, 8, 80
    models = [model_of(name), model_of(name)]
    for model, h in zip(models, (step, step / fine), strict=True):
        model.opt.timestep, model.opt.integrator = h, mujoco.mjtIntegrator.mjINT_RK4
        model.opt.tolerance, model.opt.iterations, model.jnt_limited[:] = 1e-14, 200, 0
        rub(model)
        model.dof_solref[:], model.dof_solimp[:, :2] = (2 * h, 1.0), 0.9999
        mujoco.mj_setConst(model, mujoco.MjData(model))
    mechanism, slow = CompiledEngine.of(models[0], exact_stiction=True), MujocoEngine(models[1], 2)
    assert mechanism is not None
    nv = models[0].nv
    state = np.concatenate([rng.normal(0, 1, (number, nv)), rng.normal(0, 0.3, (number, nv))], axis=1)
    control = np.repeat(rng.normal(0, 0.3, (number, 4, models[0].nu + nv)), steps // 4, axis=1)
    copies = [Copies([m], [AppliedEffects()], np.zeros(number, int), np.zeros(number, int)) for m in models]
    path = mechanism.run(mechanism.batch(copies[0]), state, control, np.zeros(number))
    full = np.zeros((number, slow.size))
    full[:, slow.motion] = state
    often = np.repeat(control, fine, axis=1)
    true = slow.run(slow.batch(copies[1]), full, often, np.zeros(number))[:, fine - 1 :: fine, slow.motion]
    error = np.abs(path - true)[..., :nv]
    assert error.max() < 1e-3
    assert (np.diff(np.sign(path[..., nv:]), axis=1) != 0).any()
    if name == "pendulum":  # as soft as MuJoCo's own constraint is unless told otherwise
        default = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>"
        )
        models[0].dof_solref[:], models[0].dof_solimp[:] = default.dof_solref, default.dof_solimp
        soft = CompiledEngine.of(models[0])
        assert soft is not None
        creeping = soft.run(soft.batch(copies[0]), state, control, np.zeros(number))
        assert np.abs(creeping - true)[..., :nv].max() > max(1e-3, 5 * error.max())


def present(effect: Effect) -> Effect:
    """Enough of it to matter."""
    middle = {p.name: p.grid[len(p.grid) // 2] if p.grid else p.absent + 4 * p.scale for p in effect.parameters()}
    return replace(effect, **middle)


DRY = {
    "asymmetric_friction": {"forward": 0.05, "backward": 0.02},
    "stribeck_friction": {"c": 0.005, "extra": 0.05},
    "position_dependent_friction": {"c": 0.04, "a": 0.0, "b": -0.02},
    "load_dependent_friction": {"mu": 0.03},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cartpole", "acrobot"])
def test_effects_push_in_compiled_steps_as_they_do_step_by_step(name):
    model = get_system(name).compile()
    model.jnt_limited[:] = 0
    runs = recordings(name, seed=3, number=2)
    compiled, by_hand = (problem_of(Simulator(model, 0.01, compiled=fast), runs) for fast in (True, False))
    state = [x[None] for x in compiled.windows.initial_states()]
    used = set()
    for file, kind in EFFECTS.items():
        if not kind.searched:
            continue
        for effect in map(present, kind.candidates(model)):
            if not effect.forces or file in DRY:
                continue
            used.add(file)
            variant, which = [Variant(np.zeros(len(compiled.nuisances)), (effect,))], np.zeros(1, int)
            path, true = (p.predict(variant, which, *state) for p in (compiled, by_hand))
            close = 2e-4 if file in ("base_motion", "mass_drift") else 1e-9  # not held over steps
            np.testing.assert_allclose(path, true, atol=close, err_msg=str(effect))
    assert len(used) >= 12


@pytest.mark.slow
@pytest.mark.parametrize("file", DRY)
def test_dry_friction_of_effects_is_the_models_own_in_every_step(file):
    """As in an environment, which sets the friction loss of the model before every step; what sticks stays."""
    model = get_system("cartpole").compile()
    model.jnt_limited[:], model.opt.timestep = 0, 0.002
    simulator = Simulator(model)
    effect = replace(present(EFFECTS[file]("hinge_1")), **DRY[file])
    still, moving = np.array([[0.0, np.pi + 0.01]]), np.array([[0.2, 2.0]])
    runs = recordings("cartpole", seed=3, number=1)
    still_runs = [replace(run, action=np.zeros_like(run.action)) for run in runs]
    windows = windows_of(still_runs, model, 0.002).take(np.zeros(2, int))
    state = np.concatenate([still, moving]), np.array([[0.0, 0.0], [0.0, -1.5]])
    variant, which = [Variant(np.zeros(len(simulator.nuisances)), (effect,))], np.zeros(1, int)
    path, speed, _ = simulator.roll(variant, which, windows, *(x[None] for x in state))
    own = copy.copy(simulator.model)
    physics, data = AddedPhysics([effect], own), mujoco.MjData(own)
    for w in range(2):
        mujoco.mj_resetData(own, data)
        physics.reset()
        data.qpos[:], data.qvel[:], true = state[0][w], state[1][w], []
        for _ in physics.steps(data, windows.steps):
            mujoco.mj_step(own, data)
            true.append(data.qpos.copy())
        np.testing.assert_allclose(path[0, w, 1:], true, atol=2e-3)
    assert np.abs(speed[0, 0, :, 1]).max() < 1e-3  # sticks, and creeps only as MuJoCo's soft constraints do
    assert np.ptp(path[0, 1, :, 1]) > 0.05
    (_,), (held,), _ = Simulator(model, 0.002).roll(variant, which, windows, *(x[None] for x in state))
    assert np.abs(held[0, :, 1]).max() < 1e-6  # accurate steps do not creep


@pytest.mark.parametrize(
    "xml",
    [
        '<worldbody><body><joint type="ball"/><geom size="0.1"/></body></worldbody>',
        '<worldbody><geom type="plane" size="1 1 1"/><body><joint/><geom size="0.1"/></body></worldbody>',
        '<option density="1.2"/><worldbody><body><joint/><geom size="0.1"/></body></worldbody>',
        '<worldbody><body><joint name="a"/><geom size="0.1"/></body></worldbody>'
        '<actuator><general joint="a" dyntype="filter" dynprm="0.1"/></actuator>',
        '<worldbody><body name="b"><joint/><geom size="0.1"/></body></worldbody><equality><weld body1="b"/></equality>',
    ],
)
def test_what_only_mujoco_can_step_is_left_to_it(xml):
    assert CompiledEngine.of(mujoco.MjModel.from_xml_string(f"<mujoco>{xml}</mujoco>")) is None
