"""What goes wrong the first time: another camera, commands left out or of other motors, clocks in milliseconds."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from keycld_envs import InputError
from keycld_envs.recordings import Recording
from keycld_envs.rerender import rerender
from keycld_model.diagnosis import diagnose_images
from keycld_model.diagnosis.inputs.prepare import uncommanded
from keycld_model.image_alignment import read_positions

ARM = """
<mujoco>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1=".5 .6 .7" rgb2=".2 .2 .3" width="64" height="64"/>
  </asset>
  <worldbody><light pos="0 -3 3"/>
    <camera name="front" pos="0 -4 0" xyaxes="1 0 0 0 0 1"/><camera name="top" pos="0 0 4" xyaxes="1 0 0 0 1 0"/>
    <geom type="box" pos="0 0 .1" size=".06 .04 .04" rgba=".3 .3 .3 1"/>
    <body name="upper"><joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .6" size=".03" rgba="1 0 0 1"/>
      <body name="lower" pos="0 0 .6"><joint name="elbow" axis="0 1 0"/><geom type="sphere" size=".08"/></body></body>
  </worldbody>
  <actuator><motor name="m_shoulder" joint="shoulder"/><motor name="m_elbow" joint="elbow"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def arm() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM)


def filmed(**changes: object) -> Recording:
    """Grey frames, which nobody has to look at."""
    t = np.arange(60, dtype=np.float64) * 0.02
    recording = Recording(
        id="run",
        source="real",
        joint_names=("shoulder", "elbow"),
        actuator_names=("m_shoulder", "m_elbow"),
        units={"action": "1"},
        t_frame=t,
        frames=np.full((60, 32, 32, 3), 128, np.uint8),
        t_action=t[:-1],
        action=np.zeros((59, 2)),
    )
    return replace(recording, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"actuator_names": ("m_elbow", "m_shoulder")}, "order the columns of action"),
        ({"actuator_names": ("m_elbow",), "action": np.zeros((59, 1))}, "record the commands of all"),
        ({"t_frame": np.arange(60) * 20.0, "t_action": np.arange(59) * 20.0}, "a frame every 20 s; t_frame must be in"),
    ],
)
def test_commands_and_clocks_are_refused_before_a_frame_is_looked_at(
    arm: mujoco.MjModel, changes: dict[str, object], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("keycld_model.diagnosis.from_images.read_positions", None)  # calling it would be an error
    with pytest.raises(InputError, match=said):
        diagnose_images([filmed(**changes)] * 2, arm)


def test_motors_that_no_recording_commands_are_named(arm: mujoco.MjModel) -> None:
    passive = filmed(action=None, t_action=None, actuator_names=(), units={})
    assert "m_shoulder, m_elbow, count as off" in uncommanded([passive, passive], arm)
    assert uncommanded([passive, filmed()], arm) == ""


@pytest.mark.render
def test_frames_of_another_camera_are_not_believed(arm: mujoco.MjModel) -> None:
    t = np.arange(8, dtype=np.float64) * 0.05
    moving = np.column_stack([np.sin(3 * t) + 1.2, np.cos(3 * t)])
    run = Recording(
        id="run", source="real", joint_names=("shoulder", "elbow"), units={"qpos": "rad"}, t_state=t, qpos=moving
    )
    seen = rerender(run, arm, "front", size=(32, 32), rate=20)
    assert read_positions([seen], arm, "top", workers=1).trusted < 0.5
