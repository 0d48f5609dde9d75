"""What `keycld check` measures and `keycld new --mjcf` proposes, against mechanisms whose truth is known."""

import math
import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keycld_envs import SYSTEMS, InputError, Joint, KeyCLDEnv, Landmark, Rod, Slider, System
from keycld_envs.inspection import inspect
from keycld_envs.inspection.camera import problems, unseen_joints
from keycld_envs.inspection.poses import Poses
from keycld_envs.inspection.propose import proposal
from keycld_envs.mechanism_file import read_system

HEAD = """<mujoco><option timestep="0.005" integrator="RK4"><flag contact="disable"/></option><worldbody>
<light pos="0 -3 3"/><camera name="side" pos="5 0 0" zaxis="1 0 0"/><camera name="front" pos="0 -6 0" zaxis="0 -1 0"/>
"""
TWO_POLES = f"""{HEAD}<body name="cart"><joint name="rail" type="slide" axis="1 0 0"/><geom type="box" size=".2 .1 .1"/>
<body name="long"><joint name="long" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 1.2" size=".06" mass=".2"/></body>
<body name="short"><joint name="short" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 .6" size=".06" mass=".1"/></body>
</body></worldbody><actuator><motor name="push" joint="rail" gear="4" ctrllimited="true" ctrlrange="-3 3"/>
<motor name="a" joint="long" ctrllimited="true" ctrlrange="-3 3"/>
<motor name="b" joint="short" ctrllimited="true" ctrlrange="-3 3"/></actuator></mujoco>"""
MOVING_PIVOT = f"""{HEAD}<body name="lift"><joint name="lift" type="slide" axis="0 0 1" range="-.5 .5" stiffness="40"/>
<geom type="box" size=".15 .1 .1" mass="1"/><body name="pole"><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 .9" size=".06" mass=".2"/></body></body></worldbody>
<actuator><motor name="lift" joint="lift" gear="4" ctrllimited="true" ctrlrange="-3 3"/></actuator></mujoco>"""
ARM = f"""{HEAD}<body name="upper" pos=".3 0 -.2"><joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 .7" size=".07" mass="1.2"/><body name="lower" pos="0 0 .7">
<joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .9" size=".06" mass=".8"/>
<geom type="sphere" pos="0 0 .9" size=".12" mass=".6"/></body></body></worldbody>
<actuator><motor name="elbow" joint="elbow" gear="2" ctrllimited="true" ctrlrange="-15 15"/></actuator></mujoco>"""
SCALE = 64 / 63 / math.tan(math.radians(22.5)) / 6
"""Image units per metre, of a camera 6 m away."""


def proposed(folder: Path, mjcf: str) -> System:
    (folder / "thing.xml").write_text(mjcf)
    (folder / "thing.py").write_text(proposal(folder / "thing.xml", folder / "thing.py"))
    return read_system(folder / "thing.py")


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_library_s_own_systems_fit_their_declaration(name: str) -> None:
    found = inspect(SYSTEMS[name])
    assert (found.problems, found.warnings, set(found.in_view)) == ((), (), {1.0})
    assert all(value.constant for value in found.constraints)


def test_a_cart_with_two_poles(tmp_path: Path) -> None:
    system = proposed(tmp_path, TWO_POLES)
    assert system.mechanism.rods == (Rod(0, 1), Rod(0, 2))
    assert system.mechanism.sliders == (Slider(0, (0.0, 1.0)),)
    assert system.camera == "front"
    assert system.hanging_qpos == pytest.approx((0, math.pi, math.pi), abs=1e-3)
    found = inspect(system)
    assert found.problems == ()
    lengths = [value.most for value in found.constraints[:2]]
    assert lengths == pytest.approx([1.2 * SCALE, 0.6 * SCALE])
    assert "--action-range" in found.warnings[0]  # 3 N m turn a pole of .6 m and .1 kg by 90 rad/s in half a second


def test_a_pendulum_on_a_moving_pivot(tmp_path: Path) -> None:
    system = proposed(tmp_path, MOVING_PIVOT)
    assert system.mechanism.rods == (Rod(0, 1),)
    assert abs(system.mechanism.sliders[0].normal[0]) == pytest.approx(1)
    assert system.joints[0].start_range == (-0.25, 0.25)  # the middle half, off the end stops
    assert system.target_qpos == pytest.approx((-1.2 * 9.81 / 40, 0), abs=1e-3)  # up, where the spring holds it
    assert system.hanging_qpos == pytest.approx((-1.2 * 9.81 / 40, math.pi), abs=1e-3)  # its weight on its spring
    assert inspect(system).problems == ()


def test_an_arm_with_a_payload(tmp_path: Path) -> None:
    system = proposed(tmp_path, ARM)
    assert system.mechanism.rods == (Rod(None, 0), Rod(0, 1))
    assert system.mechanism.pivot == pytest.approx((0.3 * SCALE, -0.2 * SCALE), abs=1e-4)
    assert [mark.position[2] for mark in system.landmarks] == [0.7, 0.9]
    assert inspect(system).problems == ()
    payload = '<geom type="sphere" pos="0 0 .9" size=".12" mass=".6"/>'
    assert payload in ARM
    held = proposed(tmp_path, ARM.replace(payload, f'<body pos="0 0 1.1">{payload.replace("0 0 .9", "0 0 0")}</body>'))
    assert [mark.position[2] for mark in held.landmarks] == [0.7, 1.1]  # on a body that is welded to the link


def test_the_pivot_that_would_fit_is_named(tmp_path: Path) -> None:
    system = proposed(tmp_path, ARM)
    moved = replace(system, mechanism=replace(system.mechanism, pivot=(0.0, 0.0)))
    assert f"pivot=({0.3 * SCALE:.3f}, {-0.2 * SCALE:.3f})" in inspect(moved).problems[0]


def test_the_normal_that_would_fit_is_named(tmp_path: Path) -> None:
    tilted = MOVING_PIVOT.replace('axis="0 0 1"', 'axis="3 0 4"')
    system = proposed(tmp_path, tilted)
    assert np.abs(system.mechanism.sliders[0].normal) == pytest.approx([0.8, 0.6], abs=1e-4)
    level = replace(system, mechanism=replace(system.mechanism, sliders=(Slider(0),)))
    assert "normal=(0.800, -0.600)" in inspect(level).problems[0]


def test_a_target_that_motors_can_just_hold(tmp_path: Path) -> None:
    system = replace(proposed(tmp_path, MOVING_PIVOT), target_qpos=(0.0, math.pi))
    needed = 1.2 * 9.81 / 4  # the weight by the gear
    just = inspect(replace(system, action_limit=1.01 * needed))
    assert just.problems == () and "leaves little to steer with" in just.warnings[0]
    assert inspect(replace(system, action_limit=1.2 * needed)).warnings == ()
    (problem,) = inspect(replace(system, action_limit=0.99 * needed)).problems
    assert f"{needed:.3g}" in problem


def test_what_is_hidden_at_the_target_is_named(tmp_path: Path) -> None:
    short, in_front = 'fromto="0 0 0 0 0 .6"', 'fromto="0 -.13 0 0 -.13 .6"'
    assert short in TWO_POLES
    within = [w for w in inspect(proposed(tmp_path, TWO_POLES)).warnings if "hidden" in w]
    assert len(within) == 1 and "body 'short' is hidden" in within[0] and "sees 0 of the" in within[0]
    before = proposed(tmp_path, TWO_POLES.replace(short, in_front))
    assert not [w for w in inspect(before).warnings if "hidden" in w]


def test_poles_at_two_places_of_a_cart(tmp_path: Path) -> None:
    short = '<body name="short"'
    system = proposed(tmp_path, TWO_POLES.replace(short, f'{short} pos=".5 0 0"'))
    assert system.mechanism.rods == (Rod(0, 1), Rod(0, 2), Rod(2, 3))
    assert system.mechanism.sliders == (Slider(0), Slider(2))
    assert [(mark.body, mark.position[0]) for mark in system.landmarks[::2]] == [("cart", 0.0), ("cart", 0.5)]
    assert inspect(system).problems == ()
    bent = replace(system, mechanism=replace(system.mechanism, rods=(Rod(0, 1), Rod(0, 2), Rod(0, 3))))
    assert "about joint 'short', which is at Landmark('cart', (0.5, 0, 0))" in inspect(bent).problems[0]


def test_two_arms_at_two_places_of_a_link(tmp_path: Path) -> None:
    second = (
        '<body name="other" pos=".5 0 .5"><joint name="wrist" axis="0 1 0"/><geom fromto="0 0 0 .4 0 0" size=".05" '
        'type="capsule" mass=".2"/></body></body></worldbody>'
    )
    system = proposed(tmp_path, ARM.replace("</body></body></worldbody>", f"</body>{second}"))
    assert system.mechanism.rods == (Rod(None, 0), Rod(0, 1), Rod(None, 2), Rod(0, 2), Rod(2, 3))
    assert inspect(replace(system, target_qpos=system.hanging_qpos)).problems == ()
    with pytest.raises(InputError, match="'other' is hinged to 'upper' at a place that rods and rails do not hold"):
        proposed(tmp_path, ARM.replace("</body></body></worldbody>", f"</body>{second}").replace(".5 0 .5", "0 0 .5"))


def test_a_pole_on_a_body_that_slides_both_ways_and_a_link_that_is_a_box(tmp_path: Path) -> None:
    both = '<joint name="lift" type="slide" axis="0 0 1" stiffness="40"/><joint name="side" type="slide" axis="1 0 0"/>'
    start = MOVING_PIVOT.index('<joint name="lift"')
    document = MOVING_PIVOT[:start] + both + MOVING_PIVOT[MOVING_PIVOT.index("<geom", start) :]
    capsule, box = 'type="capsule" fromto="0 0 0 0 0 .9" size=".06"', 'type="box" pos="0 0 .4" size=".05 .05 .4"'
    system = proposed(tmp_path, document.replace(capsule, box))
    assert (system.mechanism.rods, system.mechanism.sliders) == ((Rod(0, 1),), ())
    assert system.landmarks[1].position == (0, 0, 0.8)


def test_a_rail_beside_the_pivot(tmp_path: Path) -> None:
    system = proposed(tmp_path, MOVING_PIVOT)
    moved = replace(system, mechanism=replace(system.mechanism, pivot=(0.3, 0.0)))
    assert "with pivot=(0.000, 0.000) it leads through it" in inspect(moved).problems[0]


def test_a_mechanism_that_is_drawn_hanging_or_cannot_be_as_it_is_drawn(tmp_path: Path) -> None:
    arm = ARM.replace(" 0 0 .7", " 0 0 -.7").replace(" 0 0 .9", " 0 0 -.9").replace("0 0 .7", "0 0 -.7")
    system = proposed(tmp_path, arm.replace("0 0 .9", "0 0 -.9"))
    assert system.hanging_qpos == pytest.approx((0, 0), abs=1e-3)
    assert np.cos(system.target_qpos) == pytest.approx((-1, 1), abs=1e-3)
    idle = inspect(replace(system, target_qpos=system.hanging_qpos))
    assert any("target_qpos is hanging_qpos" in warning for warning in idle.warnings)
    limited = proposed(tmp_path, ARM.replace('name="elbow" axis="0 1 0"', 'name="elbow" axis="0 1 0" range="30 120"'))
    assert limited.target_qpos[1] == pytest.approx(math.radians(75), abs=1e-4)
    assert not [p for p in inspect(limited).problems if "outside its range" in p]


def test_documents_that_no_declaration_can_be_made_for(tmp_path: Path) -> None:
    for mjcf, words in (
        (TWO_POLES.split("<actuator>")[0].replace('name="rail"', "") + "</mujoco>", "joint 0 has no name"),
        (TWO_POLES.replace(' name="push"', ""), "actuator 0 has no name"),
        (TWO_POLES.replace(HEAD, "<mujoco><worldbody>"), "no camera"),
        (TWO_POLES.replace('type="slide" axis="1 0 0"', 'type="free"'), "hinge and slide"),
        ("<mujoco/>", "hinge and slide"),
        (
            ARM.replace(
                "</body></body>", f"</body></body>{TWO_POLES[TWO_POLES.index('<body') :].split('</worldbody>')[0]}"
            ),
            "does not lead through the pivot",
        ),
        (
            MOVING_PIVOT.replace(
                "</worldbody>",
                '<body name="b" pos="1 0 1"><joint name="b" axis="0 1 0"/><geom size=".1"/></body></worldbody>',
            ),
            "one pivot",
        ),
        (MOVING_PIVOT.replace('name="hinge"', 'name="hinge" type="slide"'), "slides on 'lift', which moves"),
        (MOVING_PIVOT.replace('name="hinge"', 'name="one" axis="0 1 0"/><joint name="hinge"'), "has 2 hinges"),
    ):
        with pytest.raises(InputError, match=words):
            proposed(tmp_path, mjcf)


def test_joints_that_start_outside_the_image(tmp_path: Path) -> None:
    system = proposed(tmp_path, TWO_POLES)
    wide = replace(system, joints=(Joint("rail", "slide", (-4.0, 4.0)), *system.joints[1:]))
    assert "out of the image" in inspect(wide).problems[0]


OFF_CENTRE = """<mujoco>
  <option><flag contact="disable"/></option>
  <worldbody>
    <light pos="0 -3 3"/><camera pos="0 0 4"/><camera name="side" pos="0 -4 0" zaxis="0 -1 0"/>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0"/><geom type="box" size=".15 .1 .08" mass="1"/>
      <body name="pole" pos="0 0 .08">
        <joint name="hinge" axis="0 1 0" frictionloss=".4" damping="1e5"/>
        <geom type="capsule" fromto="0 0 0 0 0 .5" size=".03" mass=".3" rgba="1 0 0 1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="rail" gear="4" ctrlrange="-1 1"/></actuator>
</mujoco>"""


@pytest.mark.render
def test_a_pole_off_the_carts_origin_with_friction_and_a_nameless_camera(tmp_path: Path) -> None:
    system = proposed(tmp_path, OFF_CENTRE)
    assert system.camera == "side"
    assert system.landmarks[0].position == pytest.approx((0, 0, 0.08))  # where the pole is hinged
    assert system.hanging_qpos == pytest.approx((0, math.pi), abs=1e-3)
    assert inspect(system).problems == ()


def unseen(system: System) -> list[int]:
    """Joints that move keypoints, and nothing in images of the model's size."""
    with closing(KeyCLDEnv(system)) as env:
        poses = Poses.of(system, env.model, 10, seed=0)
        return unseen_joints(poses, lambda qpos: env.render_qpos(qpos, width=64, height=64))


WHEEL = f"""{HEAD}<body name="cart"><joint name="rail" type="slide" axis="1 0 0"/><geom type="box" size=".2 .1 .1"/>
<body name="wheel"><joint name="axle" axis="0 1 0"/>
<geom type="cylinder" fromto="0 -.2 0 0 -.1 0" size=".3" rgba="0 0 0 0"/></body></body></worldbody></mujoco>"""


@pytest.mark.render
def test_every_joint_is_seen_to_move(tmp_path: Path) -> None:
    for system in SYSTEMS.values():
        assert unseen(system) == []
    for mjcf in (TWO_POLES, MOVING_PIVOT, ARM, OFF_CENTRE):
        assert unseen(proposed(tmp_path, mjcf)) == []


@pytest.mark.render
def test_a_joint_that_nobody_sees_move(tmp_path: Path) -> None:
    invisible = '<geom rgba="0 0 0 0" '
    pole, ball = '<geom type="capsule" fromto="0 0 0 0 0 .9"', '<geom type="sphere"'
    assert unseen(proposed(tmp_path, ARM.replace(pole, pole.replace("<geom ", invisible)))) == []  # its ball is seen
    lower = ARM.replace(pole, pole.replace("<geom ", invisible)).replace(ball, ball.replace("<geom ", invisible))
    assert unseen(proposed(tmp_path, lower)) == [1]
    assert unseen(proposed(tmp_path, ARM.replace("<geom ", invisible))) == [0, 1]
    night = HEAD.replace("<worldbody>", '<visual><headlight active="0"/></visual><worldbody>')
    dark = ARM.replace(HEAD, night.replace('<light pos="0 -3 3"/>', "")).replace("<geom ", '<geom rgba="0 0 0 1" ')
    assert unseen(proposed(tmp_path, dark)) == [0, 1]


@pytest.mark.render
def test_a_wheel_may_turn_unseen_unless_a_keypoint_turns_with_it(tmp_path: Path) -> None:
    system = proposed(tmp_path, WHEEL)
    rim = replace(system, landmarks=(Landmark("cart", (0, 0, 0)), Landmark("wheel", (0, 0, 0.3))))
    assert unseen(rim) == [1]
    assert unseen(replace(rim, landmarks=(Landmark("cart", (0, 0, 0)), Landmark("wheel", (0, 0, 0))))) == []


def test_distance_is_told_before_what_follows_from_it(tmp_path: Path) -> None:
    def said(system: System) -> list[str]:
        return list(problems(Poses.of(system, system.compile(), 20, seed=0)))

    for away in (150, 200, 500, 1e5):
        far = proposed(tmp_path, ARM.replace('pos="0 -6 0"', f'pos="0 -{away:g} 0"'))
        (sentence,) = said(far)
        assert "The camera 'front' is too far away" in sentence
        nearer = float(re.findall(r"about (\S+) m", sentence)[0])
        assert said(proposed(tmp_path, ARM.replace('pos="0 -6 0"', f'pos="0 -{nearer:g} 0"'))) == []
    on_joint = replace(far, landmarks=(Landmark("upper", (0, 0, 0)), Landmark("upper", (0, 0, 0))))
    near = replace(on_joint, mjcf=ARM)
    assert "never moves" in said(near)[0]


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[2] / "examples" / "mechanisms").glob("*.xml")))
def test_examples_of_new_mechanisms_fit(path: Path, tmp_path: Path) -> None:
    found = inspect(proposed(tmp_path, path.read_text(encoding="utf-8")))
    assert found.problems == () and set(found.in_view) == {1.0}
    assert not [w for w in found.warnings if "hidden" in w]
