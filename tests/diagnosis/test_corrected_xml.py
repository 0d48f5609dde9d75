"""corrected.xml is the fitted simulator, to the last digit, in MuJoCo's own words."""

import shutil
from pathlib import Path

import imageio.v3 as iio
import mujoco
import numpy as np
import pytest

from keycld_envs.effects import (
    ActuatorDeadZone,
    ActuatorDelay,
    ActuatorGain,
    ActuatorLag,
    ActuatorSaturation,
    AddedInertia,
    ClockDrift,
    CoulombFriction,
    Effect,
    GravityTilt,
    QuadraticDrag,
    Spring,
    StribeckFriction,
    ViscousFriction,
)
from keycld_envs.effects.added_physics import AddedPhysics
from keycld_envs.errors import InputError
from keycld_envs.systems import REFERENCE_SYSTEMS
from keycld_model.diagnosis.inputs.source import Source
from keycld_model.diagnosis.output.mjcf import write_corrected
from keycld_model.diagnosis.simulation.simulator import Simulator, Variant
from keycld_model.diagnosis.verdict.evidence import Evidence

ARM = """
<mujoco>
  <compiler angle="degree" settotalmass="3" inertiafromgeom="true"/>
  <option gravity="0 0 -9.81" timestep=".002"><flag contact="disable"/></option>
  <default><joint axis="0 1 0" damping=".01"/><geom type="capsule" size=".03"/></default>
  <worldbody>
    <body name="a" euler="0 30 0"><joint name="a" stiffness="1" springref="20"/><geom fromto="0 0 0 0 0 -.3"/>
      <body name="b" pos="0 0 -.3"><joint name="b"/><geom fromto="0 0 0 0 0 -.3"/>
        <body name="c" pos="0 0 -.3"><joint name="c"/><geom fromto="0 0 0 0 0 -.3"/>
          <body pos="0 0 -.3"><geom type="box" size=".05 .03 .07" euler="10 20 30"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m" joint="b" ctrlrange="-3 3" ctrllimited="true"/><position name="p" joint="c" kp="2"/>
  </actuator>
</mujoco>
"""


def source(system: str, folder: Path) -> Source:
    if system != "arm":
        return Source.of_environment(system)
    (folder / "arm.xml").write_text(ARM)
    return Source.of_file(folder / "arm.xml")


def fitted(source: Source, *effects: Effect) -> Evidence:
    """What a fit with every nuisance off would leave."""
    simulator = Simulator(source.model, 0.01)
    values = 0.1 * np.random.default_rng(0).normal(size=len(simulator.nuisances))
    names = tuple(source.model.joint(j).name for j in range(source.model.nv))
    return Evidence(
        nominal=source.model,
        refitted=simulator.compile(Variant(values)),
        effects=effects,
        channels=names,
        units=("rad",) * len(names),
        noise=np.ones(len(names)),
        rollouts=(),
        residuals=(),
    )


def path(model: mujoco.MjModel, commands: np.ndarray, effects: tuple[Effect, ...] = ()) -> np.ndarray:
    """Positions `[T, nv]` under commands `[T, nu]`."""
    data, out = mujoco.MjData(model), np.empty((len(commands), model.nv))
    physics = AddedPhysics(effects, model)
    physics.reset()
    data.qpos[:] = 1.0
    for k, u in enumerate(commands):
        data.ctrl[:] = u
        for _ in physics.steps(data, 1):
            mujoco.mj_step(model, data)
        out[k] = data.qpos
    return out


def commands(model: mujoco.MjModel, steps: int = 200) -> np.ndarray:
    return np.repeat(np.random.default_rng(1).uniform(-1, 1, (steps // 10, model.nu)), 10, axis=0)


@pytest.mark.parametrize("system", [*REFERENCE_SYSTEMS, "arm"])
def test_the_file_moves_like_the_fitted_model(system, tmp_path):
    simulator = source(system, tmp_path)
    joint, tilt = simulator.model.joint(simulator.model.njnt - 1).name, GravityTilt(alpha=0.03)
    numbers = ViscousFriction(joint, b=0.012345678901), CoulombFriction(joint, c=0.03), AddedInertia(joint, i=0.01)
    evidence = fitted(simulator, *numbers, QuadraticDrag(joint, d=0.001), tilt)
    written = write_corrected(evidence, simulator, tmp_path / "corrected.xml")
    assert (written.others, written.actuators) == ([], {})
    got = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    u = commands(got)
    np.testing.assert_allclose(path(got, u), path(evidence.corrected, u), rtol=0, atol=1e-9)
    assert np.abs(path(got, u) - path(evidence.refitted, u)).max() > 0.01
    assert got.dof_damping[-1] == evidence.corrected.dof_damping[-1]


@pytest.mark.parametrize(
    "effects, within",
    [
        ((ActuatorGain("p", k=1.2),), 0.0),
        ((ActuatorGain("m", k=0.8), ActuatorSaturation("m", s=0.5)), 0.0),
        ((ActuatorSaturation("m", s=0.5), ActuatorGain("m", k=0.8)), 0.0),
        ((ActuatorDelay("m", d=0.025),), 0.02),
        ((ActuatorLag("p", lag=0.05),), 0.02),
        ((Spring("a", k=0.5, f=0.2),), 0.05),
    ],
    ids=lambda value: value[0].id if isinstance(value, tuple) else "",
)
def test_springs_and_motors_are_mujocos_own(effects, within, tmp_path):
    """Over a second they move as the effects do, up to what integrators make of a force that is held over a step."""
    simulator = source("arm", tmp_path)
    evidence = fitted(simulator, *effects)
    written = write_corrected(evidence, simulator, tmp_path / "corrected.xml")
    assert (written.effects, written.others) == (list(effects), [])
    got = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    u = commands(got)[:100]
    true, without = path(evidence.refitted, u, effects), path(evidence.refitted, u)
    assert np.abs(path(got, u) - true).max() <= within * np.abs(without - true).max() + 1e-9


def test_a_spring_adds_to_the_one_that_is_there(tmp_path):
    simulator = source("arm", tmp_path)
    write_corrected(fitted(simulator, Spring("a", k=0.5, f=0.2)), simulator, tmp_path / "corrected.xml")
    got = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    assert got.jnt_stiffness[0] == 1.5
    assert got.qpos_spring[0] == pytest.approx((np.deg2rad(20) + 0.2) / 1.5, abs=1e-12)


def test_what_mujoco_lacks_is_left_to_its_class_and_comes_first(tmp_path):
    """A dead zone after a gain keeps the gain out of the file; friction half in the file would count twice."""
    simulator = source("acrobot", tmp_path)
    friction, zone = StribeckFriction("elbow", c=0.05, extra=0.02, vs=0.3), ActuatorDeadZone("elbow", delta=0.2)
    gain, drift = ActuatorGain("elbow", k=1.1), ClockDrift(epsilon=0.01)
    evidence = fitted(simulator, friction, gain, zone, ViscousFriction("shoulder", b=0.1), drift)
    written = write_corrected(evidence, simulator, tmp_path / "corrected.xml")
    assert written.others == [friction, gain, zone, drift]
    text = (tmp_path / "corrected.xml").read_text()
    assert 'StribeckFriction("elbow", c=0.05, extra=0.02, vs=0.3)' in text.split("-->")[0]
    got = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    assert got.dof_frictionloss.tolist() == [0, 0] and got.dof_damping.tolist() == [0.1, 0]
    after = native_order(simulator, zone, gain, tmp_path)
    assert after.actuator_gainprm[1, 0] == pytest.approx(1.1)
    u = commands(got)
    both = path(fitted(simulator).refitted, u, (zone, gain))
    np.testing.assert_allclose(path(after, u, (zone,)), both, rtol=0, atol=1e-9)


def native_order(simulator: Source, zone: Effect, gain: Effect, folder: Path) -> mujoco.MjModel:
    written = write_corrected(fitted(simulator, zone, gain), simulator, folder / "other.xml")
    assert (written.effects, written.others) == ([gain], [zone])
    return mujoco.MjModel.from_xml_path(str(folder / "other.xml"))


ASSETS = """
<mujoco>
  <compiler meshdir="meshes" texturedir="textures"/>
  <asset>
    <mesh name="one" file="a.obj"/><mesh name="two" file="sub/a.obj"/><mesh name="again" file="a.obj" scale="2 2 2"/>
    <texture name="flat" type="2d" file="p.png"/>
    <texture name="sky" type="skybox" fileright="p.png" fileleft="p.png" fileup="p.png" filedown="p.png"
      filefront="sub/p.png" fileback="p.png"/>
    <hfield name="ground" file="h.png" size="1 1 1 .1"/>
  </asset>
  <worldbody>
    <geom type="hfield" hfield="ground" contype="0" conaffinity="0"/>
    <body name="a"><joint name="a" axis="0 1 0"/><geom type="mesh" mesh="one"/>
      <body name="b" pos="0 0 -.3"><joint name="b" axis="0 1 0"/><geom type="mesh" mesh="two"/></body>
    </body>
  </worldbody>
</mujoco>
"""
NAMES = {"a.obj", "a_2.obj", "p.png", "p_2.png", "h.png"}


def files() -> dict[str, bytes]:
    """What `ASSETS` refers to; names come twice."""
    corners = "v 0 0 0\nv {0} 0 0\nv 0 .1 0\nv 0 0 -.2\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    out = {f"meshes/{name}": corners.format(x).encode() for name, x in (("a.obj", 0.1), ("sub/a.obj", 0.3))}
    for name, grey in (("textures/p.png", 10), ("textures/sub/p.png", 99), ("meshes/h.png", 50)):
        out[name] = iio.imwrite("<bytes>", np.full((8, 8, 3), grey, dtype=np.uint8), extension=".png")
    return out


@pytest.fixture
def original(tmp_path) -> Path:
    """An MJCF file with its assets, in a folder."""
    for name, content in {"x.xml": ASSETS.encode(), **files()}.items():
        (tmp_path / "original" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "original" / name).write_bytes(content)
    return tmp_path / "original" / "x.xml"


@pytest.mark.parametrize("held", ["in files", "in memory"])
def test_assets_lie_beside_the_file_and_move_with_it(held, original, tmp_path):
    first, moved = tmp_path / "first", tmp_path / "moved"
    simulator = Source.of_file(original)
    if held == "in memory":
        simulator = Source(simulator.model, ASSETS, files())
        shutil.rmtree(original.parent)
    write_corrected(fitted(simulator, ViscousFriction("b", b=0.1)), simulator, first / "corrected.xml")
    assert {p.name for p in first.iterdir()} == {"corrected.xml", "corrected_assets"}
    assert {p.name for p in (first / "corrected_assets").iterdir()} == NAMES
    assert str(tmp_path) not in (first / "corrected.xml").read_text()
    shutil.rmtree(original.parent, ignore_errors=True)
    first.rename(moved)
    got = mujoco.MjModel.from_xml_path(str(moved / "corrected.xml"))
    assert got.dof_damping.tolist() == [0, 0.1]
    for name in ("mesh_vert", "tex_data", "hfield_data", "geom_dataid"):
        np.testing.assert_array_equal(getattr(got, name), getattr(simulator.model, name))


def test_an_asset_that_is_gone_is_named_and_there_is_no_file(original, tmp_path):
    simulator = Source.of_file(original)
    (original.parent / "meshes/h.png").unlink()
    with pytest.raises(InputError, match=r"h\.png"):
        write_corrected(fitted(simulator), simulator, tmp_path / "out" / "corrected.xml")
    assert not (tmp_path / "out").exists()


def test_an_asset_that_mujoco_loses_is_named_and_there_is_no_file(original, tmp_path):
    """It writes the file of an attached model's mesh without the model's folder."""
    inner = (
        '<mujoco><compiler meshdir="meshes/sub"/><asset><mesh name="m" file="a.obj"/></asset><worldbody><body name="c">'
    )
    inner += '<joint name="c" axis="0 1 0"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    original.with_name("inner.xml").write_text(inner)
    outer = (
        '<mujoco><asset><model name="i" file="inner.xml"/></asset><worldbody><attach model="i" body="c" prefix="i_"/>'
    )
    original.write_text(outer + "</worldbody></mujoco>")
    simulator = Source.of_file(original)
    with pytest.raises(InputError, match=r"a\.obj"):
        write_corrected(fitted(simulator), simulator, tmp_path / "out" / "corrected.xml")
    assert not (tmp_path / "out").exists()


def test_without_mjcf_there_is_no_file(tmp_path):
    model = Source.of_environment("pendulum").model
    unknown = Source(model, None, environment="Mine/Arm-v0")
    with pytest.raises(InputError, match="Mine/Arm-v0 does not tell its MJCF"):
        write_corrected(fitted(unknown), unknown, tmp_path / "corrected.xml")
    assert not (tmp_path / "corrected.xml").exists()
