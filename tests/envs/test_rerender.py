"""Joint recordings, drawn: what is in the frames, when they are, and what is refused."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from keycld_control.cli import main
from keycld_envs import InputError, get_system
from keycld_envs.collect import action_range_of
from keycld_envs.recordings import Recording, read_dataset, write_recording
from keycld_envs.rerender import count_frames, rerender

pytestmark = pytest.mark.render
ARM = """
<mujoco>
  <worldbody><light pos="0 -3 3"/><camera name="front" pos="0 -4 0" xyaxes="1 0 0 0 0 1"/>{more}
    <body><joint name="shoulder" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .6" size=".03" rgba="1 0 0 1"/>
      <body pos="0 0 .8"><joint name="elbow" axis="0 1 0"/><geom type="sphere" size=".2" rgba="0 1 0 1"/></body></body>
  </worldbody>
</mujoco>
"""


def arm(more: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM.format(more=more))


def logged(times: np.ndarray, shoulder: np.ndarray) -> Recording:
    """Columns of the joints are not in the order of the model."""
    return Recording(
        id="run",
        source="real",
        joint_names=("elbow", "shoulder"),
        units={"qpos": "rad"},
        t_state=times,
        qpos=np.column_stack([np.zeros(len(times)), shoulder]),
    )


def middle_of_the_ball(frame: np.ndarray) -> np.ndarray:
    """Column and row, from the middle of the frame, upwards."""
    green = frame[..., 1].astype(int) - frame[..., 0] > 20
    rows, columns = np.nonzero(green)
    return np.array([columns.mean(), 63 - rows.mean()]) - 31.5


@pytest.mark.parametrize("unit", ["deg", ("rad", "mm")])
def test_positions_in_other_units_are_refused(unit: str | tuple[str, str]) -> None:
    times = np.arange(0, 1, 0.01)
    recording = replace(logged(times, 100 * times), units={"qpos": unit})
    with pytest.raises(InputError, match=r"'(elbow|shoulder)' in '(deg|mm)'; convert qpos to rad or m"):
        count_frames(recording, arm(), 20)


def test_frames_show_the_measured_positions_at_the_time_at_which_they_were_measured():
    times = 100 + np.sort(np.random.default_rng(0).uniform(0, 0.5, 200))
    drawn = rerender(logged(times, 3 * (times - 100)), arm(), "front", rate=20)
    assert drawn.source == "rerendered"
    assert drawn.t_frame is not None and drawn.frames is not None
    assert len(drawn.t_frame) == count_frames(drawn, arm(), 20) == 10
    assert set(drawn.t_frame) <= set(times)
    np.testing.assert_allclose(np.diff(drawn.t_frame), 0.05, atol=0.01)
    ball = np.array([middle_of_the_ball(frame) for frame in drawn.frames])
    assert np.hypot(*ball.T) == pytest.approx(np.hypot(*ball.T).mean(), rel=0.08)
    np.testing.assert_allclose(np.arctan2(*ball.T), 3 * (drawn.t_frame - 100), atol=0.06)  # clockwise from above


def test_where_nothing_was_measured_there_is_no_frame():
    times = np.arange(100) / 100
    angle = np.where((times > 0.3) & (times < 0.7), np.nan, times)
    drawn = rerender(logged(times, angle), arm(), "front", rate=10)
    assert drawn.t_frame is not None
    np.testing.assert_allclose(drawn.t_frame, [0, 0.1, 0.2, 0.3, 0.7, 0.8, 0.9], atol=0.03)
    alone = rerender(logged(times[:1], times[:1]), arm(), "front", rate=10)
    assert alone.num_frames == 1


def test_what_cannot_be_drawn_is_refused():
    log = logged(np.arange(5.0), np.zeros(5))
    with pytest.raises(InputError, match=r"'run' has the joints elbow, shoulder, the simulator has hinge"):
        rerender(log, get_system("pendulum").compile(), "fixed")
    no_joints = replace(log, t_state=None, qpos=None, t_frame=np.arange(2.0), frames=np.zeros((2, 8, 8, 3), np.uint8))
    with pytest.raises(InputError, match="no joint positions"):
        rerender(no_joints, arm(), "front")
    with pytest.raises(InputError, match="no sample at which all joints were measured"):
        rerender(logged(np.arange(5.0), np.full(5, np.nan)), arm(), "front")


def test_command(tmp_path, capsys):
    write_recording(tmp_path / "logs" / "run", logged(np.arange(20) / 100, np.linspace(0, 1, 20)))
    (tmp_path / "arm.xml").write_text(ARM.format(more=""))
    (tmp_path / "two.xml").write_text(ARM.format(more='<camera name="top" pos="0 0 4"/>'))
    (tmp_path / "logs" / "collect.json").write_text('{"action_range": 2.5}')
    words = ["rerender", str(tmp_path / "logs"), "--mjcf", str(tmp_path / "arm.xml"), "--fps", "25", "--width", "32"]
    assert main([*words, "--out", str(tmp_path / "out"), "--disturb", "noise=5", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 5
    (found,) = read_dataset(tmp_path / "out").recordings
    assert found.load_frames().shape == (5, 64, 32, 3)
    assert found.camera is not None and found.camera["name"] == "front"
    assert action_range_of(tmp_path / "out") == 2.5
    assert main([*words, "--out", str(tmp_path / "again"), "--disturb", "noise=5"]) == 0
    np.testing.assert_array_equal(read_dataset(tmp_path / "again").recordings[0].load_frames(), found.load_frames())
    capsys.readouterr()
    for wrong, why in [
        (["--out", str(tmp_path / "out")], "exists"),
        (["--out", str(tmp_path / "new"), "--mjcf", str(tmp_path / "two.xml")], "has the cameras front, top"),
        (["--out", str(tmp_path / "new"), "--camera", "side"], "no camera 'side'"),
        (["--out", str(tmp_path / "new"), "--fps", "0"], "--fps is 0"),
        (["--out", str(tmp_path / "new"), "--disturb", "fog=1"], "no disturbance 'fog'"),
    ]:
        assert main([*words, *wrong]) == 2
        assert why in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
