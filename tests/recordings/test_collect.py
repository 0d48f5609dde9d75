"""Collected data depend on the settings only, and survive a kill."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keycld_control.cli._simulator import simulator_of
from keycld_envs.collect import CollectSettings, collect, make_env, record_episode
from keycld_envs.errors import InputError
from keycld_envs.policies import POLICIES, get_policy
from keycld_envs.recordings import read_dataset

SMALL = CollectSettings("KeyCLD/Cartpole-v0", steps=4, width=16, height=16)


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.render
def test_collecting(tmp_path: Path) -> None:
    summary = collect(tmp_path / "a", SMALL, episodes=3)
    assert (summary.newly_recorded, summary.already_there, summary.episodes) == (3, 0, 3)
    data = read_dataset(tmp_path / "a")
    first = data.recordings[0]
    assert first.system == data.system == "KeyCLD/Cartpole-v0"
    assert (first.source, first.render_quality, first.seed) == ("simulation", "fast", 0)
    assert first.joint_names == ("slider", "hinge_1")
    sequences = data.sequences()
    assert sequences.frames.shape == (3, 4, 16, 16, 3)
    assert sequences.actions.shape == (3, 3, 2)
    assert sequences.timestep == pytest.approx(0.01)
    assert first.units == {"action": ("4 N", "1 N m"), "qpos": ("m", "rad"), "qvel": ("m/s", "rad/s")}
    assert first.qpos is not None
    assert first.qvel is not None
    np.testing.assert_array_equal(first.qvel[0], 0)
    assert len({r.frames.tobytes() for r in data.recordings if r.frames is not None}) == 3


@pytest.mark.render
def test_the_recorded_actions_replay_the_recorded_motion(tmp_path: Path) -> None:
    settings = CollectSettings("KeyCLD/Acrobot-v0", steps=6, policy="piecewise", velocity=0.1, width=16, height=16)
    collect(tmp_path / "a", settings, episodes=1)
    recording = read_dataset(tmp_path / "a").recordings[0]
    assert recording.qpos is not None
    assert recording.qvel is not None
    assert recording.action is not None
    assert recording.frames is not None
    assert 0 < abs(recording.qvel[0]).max() <= 0.1
    env = make_env(settings)
    env.reset(options={"qpos": recording.qpos[0], "qvel": recording.qvel[0]})
    for i, action in enumerate(recording.action):
        pixels, _, _, _, info = env.step(action.astype(np.float32))
        np.testing.assert_array_equal(info["qpos"], recording.qpos[i + 1])
        np.testing.assert_array_equal(pixels, recording.frames[i + 1])
    env.close()


@pytest.mark.render
def test_the_result_does_not_depend_on_workers_or_episodes(tmp_path: Path) -> None:
    collect(tmp_path / "one", SMALL, episodes=5)
    collect(tmp_path / "two", SMALL, episodes=2)
    summary = collect(tmp_path / "two", SMALL, episodes=5, workers=2)
    assert (summary.newly_recorded, summary.already_there) == (3, 2)
    assert content(tmp_path / "one") == content(tmp_path / "two")
    assert collect(tmp_path / "two", SMALL, episodes=5).newly_recorded == 0


@pytest.mark.render
@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_killed_collection_resumes_to_the_same_data(tmp_path: Path, workers: str) -> None:
    command = [sys.executable, "-m", "keycld_control.cli", "collect", "cartpole", "--steps", "4", "--episodes", "400"]
    command += ["--width", "16", "--height", "16", "--workers", workers, "--out", str(tmp_path / "a")]
    process = subprocess.Popen(command, start_new_session=True)
    deadline = time.monotonic() + 60
    while len(list(tmp_path.glob("a/episode-*"))) < 2:
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    while True:  # workers notice their parent's death
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        assert time.monotonic() < deadline
        time.sleep(0.05)
    complete = len(list(tmp_path.glob("a/episode-*")))
    assert complete < 400
    for extra in sorted(tmp_path.glob("a/episode-*"))[3:]:
        for file in extra.iterdir():
            file.unlink()
        extra.rmdir()
    collect(tmp_path / "a", SMALL, episodes=5)
    collect(tmp_path / "b", SMALL, episodes=5)
    left = {name: data for name, data in content(tmp_path / "a").items() if ".partial" not in name}
    assert left == content(tmp_path / "b")


@pytest.mark.render
def test_other_settings_and_foreign_folders_are_refused(tmp_path: Path) -> None:
    collect(tmp_path / "a", SMALL, episodes=2)
    with pytest.raises(InputError, match="collected with seed=0, not 1"):
        collect(tmp_path / "a", replace(SMALL, seed=1), episodes=2)
    with pytest.raises(InputError, match="holds episode-00001 beyond the 1 episodes"):
        collect(tmp_path / "a", SMALL, episodes=1)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "thesis.tex").touch()
    with pytest.raises(InputError, match="not made by `keycld collect`"):
        collect(tmp_path / "b", SMALL, episodes=1)
    with pytest.raises(InputError, match="is a file"):
        collect(tmp_path / "b" / "thesis.tex", SMALL, episodes=1)


@pytest.mark.render
def test_settings_that_recorded_nothing_may_change(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="camera"):
        collect(tmp_path / "a", replace(SMALL, camera="nowhere"), episodes=1)
    assert collect(tmp_path / "a", SMALL, episodes=1).newly_recorded == 1


@pytest.mark.parametrize(
    ("field", "value"),
    [("steps", 1), ("width", 0), ("seed", -1), ("velocity", -1.0), ("velocity", float("nan")), ("action_range", 0.0)],
)
def test_settings_out_of_range(field: str, value: float) -> None:
    with pytest.raises(InputError, match=field):
        replace(SMALL, **{field: value})


def test_the_least_velocity_is_told_as_nought() -> None:
    with pytest.raises(InputError, match=r"velocity is -1\.0; it must be a number from 0 up to"):
        replace(SMALL, velocity=-1.0)


@pytest.mark.render
def test_the_action_range_is_the_papers_unless_given() -> None:
    for settings, bound in (
        (CollectSettings("KeyCLD/Acrobot-v0"), 3.0),
        (CollectSettings("KeyCLD/PendulumStock-v0"), 1.0),
        (CollectSettings("KeyCLD/Pendulum-v0", action_range=5.0), 5.0),
    ):
        settings = replace(settings, steps=2, width=4, height=4)
        env = make_env(settings)
        actions = np.array([record_episode(env, settings, i).action for i in range(30)])
        env.close()
        assert 0.7 * bound < np.abs(actions).max() <= bound


OWN_MODULE = """
import keycld_envs
from keycld_envs import Joint, Landmark, Mechanism, Slider, System

SLIDER = System(
    name="slider",
    mjcf='''
    <mujoco>
      <worldbody>
        <camera name="front" pos="0 -2 0" zaxis="0 -1 0"/>
        <body name="cart">
          <joint name="rail" type="slide" axis="1 0 0"/>
          <geom type="box" size=".1 .1 .1" mass="2"/>
        </body>
      </worldbody>
      <actuator><motor name="push" joint="rail"/></actuator>
    </mujoco>
    ''',
    joints=(Joint("rail", "slide", (-0.5, 0.5)),),
    actuators=("push",),
    mechanism=Mechanism(num_keypoints=1, num_actions=1, sliders=(Slider(0),)),
    landmarks=(Landmark("cart"),),
    camera="front",
    timestep=0.02,
    target_qpos=(0.0,),
    hanging_qpos=(0.3,),
)
keycld_envs.register(SLIDER, "MyLab/Slider-v0")
"""


@pytest.mark.render
@pytest.mark.parametrize(
    "command", [["keycld"], pytest.param(["python", "-m", "keycld_control.cli"], marks=pytest.mark.long)]
)
def test_a_system_of_ones_own(tmp_path: Path, command: list[str]) -> None:
    """Its module lies in the working folder, and workers, which are new processes, import it too."""
    (tmp_path / "my_module.py").write_text(OWN_MODULE)
    program = [str(Path(sys.executable).with_name(command[0])), *command[1:], "collect"]
    options = ["--episodes", "4", "--steps", "3", "--width", "16", "--height", "16", "--out", "data"]
    for system, workers in (("my_module:MyLab/Slider-v0", "2"), ("my_module:slider", "1")):  # the second resumes
        done = subprocess.run(
            [*program, system, *options, "--workers", workers], cwd=tmp_path, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    data = read_dataset(tmp_path / "data")
    assert data.system == "my_module:MyLab/Slider-v0"
    assert data.sequences().frames.shape == (4, 3, 16, 16, 3)
    assert data.recordings[0].units["action"] == ("1 N",)


def test_other_environments_are_refused() -> None:
    with pytest.raises(InputError, match="CartPole-v1 is no KeyCLD environment"):
        make_env(CollectSettings("CartPole-v1"))


@pytest.mark.parametrize("name", POLICIES)
def test_policies(name: str) -> None:
    low, high = np.array([-3.0, 0.0]), np.array([3.0, 1.0])
    runs = np.array([get_policy(name)(np.random.default_rng(i), 40, low, high) for i in range(500)])
    assert runs.shape == (500, 40, 2)
    assert (runs >= low).all()
    assert (runs <= high).all()
    zero = (runs == 0).all(axis=-1).mean()
    if name == "release":
        assert zero == 1
        return
    assert 0.15 < zero < 0.25
    changes = (np.diff(runs, axis=1) != 0).any(axis=-1).sum(axis=1)
    if name == "constant":
        assert (changes == 0).all()
        assert abs(runs[..., 0].mean()) < 0.3
    else:
        assert 2 < changes.mean() < 10


def test_an_unknown_policy_suggests_one() -> None:
    with pytest.raises(InputError, match="did you mean 'piecewise'"):
        get_policy("piecwise")


def test_a_simulator_has_the_range_that_motors_were_recorded_with(tmp_path: Path) -> None:
    collect(tmp_path / "wide", CollectSettings("pendulum", steps=3, action_range=6.0), 1)
    recordings = read_dataset(tmp_path / "wide").recordings
    model = simulator_of(tmp_path / "wide", recordings, None, None).model
    assert model.actuator_ctrlrange.tolist() == [[-6.0, 6.0]]
    collect(tmp_path / "usual", CollectSettings("pendulum", steps=3), 1)
    assert simulator_of(tmp_path / "usual", recordings, None, None).model.actuator_ctrlrange.tolist() == [[-3.0, 3.0]]
    mixed = [*recordings, replace(recordings[0], id="other", system="KeyCLD/PendulumStock-v0")]
    with pytest.raises(InputError, match="2 simulators"):
        simulator_of(tmp_path / "wide", mixed, None, None)
