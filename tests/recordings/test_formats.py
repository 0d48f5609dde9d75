"""Recordings to formats of other programs and back, and data of other programs, as their own packages write them."""

import json
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, read_dataset, read_recording, write_recording
from keycld_envs.recordings.importers import open_data_set, read_mcap
from keycld_envs.recordings.storage import META
from keycld_envs.recordings.validation import SIGNALS
from keycld_envs.recordings.video import write_video

Make = Callable[..., Recording]


def export(folder: Path, to: str, *recordings: Recording, more: tuple[str, ...] = ()) -> Path:
    for recording in recordings:
        write_recording(folder / "in" / recording.id, recording)
    out = folder / "out"
    assert main(["export", str(folder / "in"), "--to", to, "--out", str(out), "--json", *more]) == 0
    return out


def back(folder: Path, out: Path, *words: str) -> tuple[Recording, ...]:
    assert main(["import", str(out), "--out", str(folder / "back"), *words]) == 0
    return read_dataset(folder / "back").recordings


def same(a: Recording, b: Recording, rtol: float) -> None:
    assert {name: getattr(a, name) for name in META} == {name: getattr(b, name) for name in META}
    for name in SIGNALS:
        left, right = getattr(a, name), getattr(b, name)
        if left is None or right is None:
            assert left is right, name
        else:
            np.testing.assert_allclose(left, right, rtol=rtol, atol=1e-12, err_msg=name)
    assert a.num_frames == b.num_frames
    if a.num_frames:
        np.testing.assert_array_equal(a.load_frames(), b.load_frames())


UNITS = {"action": "2 N", "qpos": ("m", "rad"), "qvel": ("m/s", "rad/s")}
FORMATS = [("minari", "minari", 0.0), ("lerobot", "pyarrow", 1e-6)]


@pytest.mark.parametrize("to, package, rtol", FORMATS)
def test_round_trip_with_frames(
    to: str, package: str, rtol: float, tmp_path: Path, make_recording: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    tmp_path = Path()  # names of folders as people type them
    start = 3.0 + 0.01 * np.arange(8)
    late = make_recording(1, t_frame=start, t_state=start, t_action=start[:-1], units=UNITS)
    recordings = [make_recording(0, units=UNITS), late]
    out = export(tmp_path, to, *recordings)
    found = back(tmp_path, out)
    assert len(found) == 2
    for a, b in zip(recordings, found, strict=True):
        same(a, b, rtol)


@pytest.mark.parametrize("to, package, rtol", FORMATS)
def test_round_trip_of_a_video_alone(to: str, package: str, rtol: float, tmp_path: Path, make_recording: Make) -> None:
    pytest.importorskip(package)
    absent: dict[str, Any] = dict.fromkeys(("qpos", "qvel", "t_state", "action", "t_action"))
    recording = make_recording(0, joint_names=(), actuator_names=(), units={}, **absent)
    (found,) = back(tmp_path, export(tmp_path, to, recording))
    same(recording, found, rtol)


@pytest.mark.parametrize("to, package, rtol", FORMATS)
def test_round_trip_of_joints_alone(to: str, package: str, rtol: float, tmp_path: Path, make_recording: Make) -> None:
    pytest.importorskip(package)
    qpos = np.random.default_rng(5).normal(size=(8, 2))
    qpos[3, 1] = np.nan
    absent: dict[str, Any] = {"qvel": None, "t_frame": None, "frames": None, "camera": None, "render_quality": None}
    recording = make_recording(0, qpos=qpos, units={"qpos": ("m", "rad"), "action": "N"}, **absent)
    (found,) = back(tmp_path, export(tmp_path, to, recording))
    same(recording, found, rtol)


@pytest.mark.parametrize("to, package", [("minari", "minari"), ("lerobot", "pyarrow")])
def test_other_clocks_are_brought_to_that_of_the_rows(
    to: str, package: str, tmp_path: Path, make_recording: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    """Actions of 1 kHz keep their impulse, positions of a line stay on it, and both are told."""
    pytest.importorskip(package)
    fast, states = 0.001 * np.arange(70), 0.0025 * np.arange(29)
    action = np.random.default_rng(6).normal(size=(70, 1))
    line = np.stack([2 * states, -states], axis=1)
    recording = make_recording(0, t_action=fast, action=action, t_state=states, qpos=line, qvel=None)
    out = export(tmp_path, to, recording)
    lost = json.loads(capsys.readouterr().out)["lost"]
    assert {"interpolated", "averaged"} <= {word for sentence in lost for word in sentence.split()}
    (found,) = back(tmp_path, out)
    assert found.qpos is not None and found.action is not None and recording.t_frame is not None
    np.testing.assert_allclose(found.qpos[:, 0], 2 * recording.t_frame, atol=1e-7)
    np.testing.assert_allclose(found.action[:, 0], action.reshape(7, 10).mean(axis=1), rtol=1e-6)


def test_lerobot_wants_a_steady_clock(tmp_path: Path, make_recording: Make, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyarrow")
    uneven = np.array([0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.09])
    recording = make_recording(0, t_frame=uneven)
    write_recording(tmp_path / "in/a", recording)
    assert main(["export", str(tmp_path / "in"), "--to", "lerobot", "--out", str(tmp_path / "out")]) == 2
    assert "run-00" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_rerun_reads_our_lerobot_data_set(tmp_path: Path, make_recording: Make) -> None:
    """Another reader of the format finds the same numbers."""
    pytest.importorskip("pyarrow")
    experimental = pytest.importorskip("rerun.experimental")
    recordings = [make_recording(0), make_recording(1)]
    reader = experimental.LeRobotReader(export(tmp_path, "lerobot", *recordings))
    assert reader.version == "v3"
    assert reader.episodes() == [0, 1]
    columns = rrd_columns(reader.stream(1, video_mode="skip").collect())
    state = next(values for path, values in columns.items() if "observation.state" in path)
    assert recordings[1].qpos is not None
    np.testing.assert_allclose(state.reshape(8, 2), recordings[1].qpos, rtol=1e-6)


def test_minari_loads_our_data_set(tmp_path: Path, make_recording: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    recording = make_recording(0)
    out = export(tmp_path, "minari", recording)
    (episode,) = minari.load_dataset(out.name).iterate_episodes()
    np.testing.assert_array_equal(episode.observations["qvel"], recording.qvel)
    np.testing.assert_array_equal(episode.actions, recording.action)
    assert episode.truncations.tolist() == [False] * 6 + [True]


def test_a_folder_that_only_looks_like_minari(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("minari")
    (tmp_path / "pen/data").mkdir(parents=True)
    (tmp_path / "pen/data/metadata.json").write_text("{}")
    assert main(["import", str(tmp_path / "pen"), "--out", str(tmp_path / "back")]) == 2
    assert "name a whole Minari data set" in capsys.readouterr().err


def test_minari_of_others_needs_its_clock_and_units(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    storage = pytest.importorskip("minari.dataset.minari_storage")
    from gymnasium.spaces import Box
    from minari.data_collector import EpisodeBuffer

    observations, actions = np.random.default_rng(1).normal(size=(2, 5, 3)), np.ones((2, 4, 1))
    (tmp_path / "pen/data").mkdir(parents=True)
    made = storage.MinariStorage.new(tmp_path / "pen/data", Box(-9, 9, (3,)), Box(-1, 1, (1,)))
    made.update_metadata({"dataset_id": "pen-v0", "minari_version": version("minari")})
    episodes = zip(observations, actions, strict=True)
    nothing = [False] * 4
    made.update_episodes(
        EpisodeBuffer(
            observations=list(o), actions=list(a), rewards=[0.0] * 4, terminations=nothing, truncations=nothing
        )
        for o, a in episodes
    )
    words = ["--time", "step", "--joint", "hinge=observations[2]", "--action", "motor=actions"]
    words += ["--action-time", "action_step", "--unit", "step=0.05 s", "--unit", "action_step=0.05 s"]
    words = [word.replace("=actions", "=actions[0]") for word in words]
    assert main(["import", str(tmp_path / "pen"), "--out", str(tmp_path / "back"), *words]) == 2
    assert "--unit observations[2]=deg" in capsys.readouterr().err
    units = ("--unit", "observations=deg", "--unit", "actions=N m")
    _, second = back(tmp_path, tmp_path / "pen", *words, *units)
    assert second.qpos is not None and second.action is not None and second.t_state is not None
    np.testing.assert_allclose(second.t_state, 0.05 * np.arange(5))
    np.testing.assert_allclose(second.qpos[:, 0], np.deg2rad(observations[1, :, 2]))
    assert second.action.tolist() == [[1.0]] * 4


MOTORS = ["shoulder_pan.pos", "elbow_flex.pos"]


def so101(folder: Path, degrees: np.ndarray, colours: np.ndarray) -> Path:
    """Two episodes in one file, in which a follower arm's angles are degrees, as LeRobot itself writes them."""
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    length, place = degrees.shape[1], "chunk-000/file-000"
    vector = {"dtype": "float32", "shape": [2], "names": MOTORS}
    scalars = {"timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64"}
    features: dict[str, Any] = {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in scalars.items()}
    features |= {"action": vector, "observation.state": vector}
    features["observation.images.front"] = {"dtype": "video", "shape": [16, 16, 3], "names": None}
    paths = {"data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"}
    paths["video_path"] = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    info = {"codebase_version": "v3.0", "robot_type": "so101_follower", "fps": 30, "features": features} | paths
    steps = np.tile(np.arange(length), 2)
    data = {
        "observation.state": list(degrees.reshape(-1, 2).astype(np.float32)),
        "action": list(degrees.reshape(-1, 2).astype(np.float32) + 1),
        "timestamp": (steps / 30).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.repeat([0, 1], length),
        "index": np.arange(2 * length),
    }
    video = "videos/observation.images.front"
    episodes = {"episode_index": [0, 1], "length": [length] * 2, "tasks": [["wave"]] * 2}
    episodes |= {f"{kind}/{which}_index": [0, 0] for kind in ("data", video) for which in ("chunk", "file")}
    episodes |= {f"{video}/from_timestamp": [0.0, length / 30], f"{video}/to_timestamp": [length / 30, length / 15]}
    for name in ("data", "meta/episodes", video):
        (folder / name / "chunk-000").mkdir(parents=True)
    parquet.write_table(pa.table(data), folder / f"data/{place}.parquet")
    parquet.write_table(pa.table(episodes), folder / f"meta/episodes/{place}.parquet")
    frames = (np.full((16, 16, 3), c, np.uint8) for c in colours.ravel())
    options = {"codec": "libsvtav1", "pix_fmt_in": "rgb24", "pix_fmt_out": "yuv420p"}
    write_video(
        folder / f"{video}/{place}.mp4", frames, (16, 16), 30, output_params=["-g", "2", "-crf", "30"], **options
    )
    (folder / "meta/info.json").write_text(json.dumps(info))
    return folder


def test_lerobot_of_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    degrees = np.random.default_rng(2).uniform(-100, 100, (2, 12, 2))
    colours = np.linspace(10, 240, 24).reshape(2, 12)
    folder = so101(tmp_path / "so101", degrees, colours)
    assert main(["import", str(folder), "--out", str(tmp_path / "back")]) == 2
    assert "--unit observation.state=deg" in capsys.readouterr().err
    for words in (["--time", "t"], ["--joint", "hinge=t"]):
        assert main(["import", str(folder), "--out", str(tmp_path / "back"), *words]) == 2
        assert "there is no column 't'; there are " in capsys.readouterr().err
    units = ["--unit", "observation.state=deg", "--unit", "action=deg"]
    _, second = back(tmp_path, folder, *units)
    assert second.joint_names == second.actuator_names == ("shoulder_pan", "elbow_flex")
    assert second.units == {"qpos": ("rad", "rad"), "action": ("rad", "rad")}
    assert second.qpos is not None and second.action is not None and second.t_state is not None
    np.testing.assert_allclose(second.t_state, np.arange(12) / 30, atol=1e-12)
    np.testing.assert_allclose(second.qpos, np.deg2rad(degrees[1]), rtol=1e-6)
    np.testing.assert_allclose(second.action, np.deg2rad(degrees[1] + 1), rtol=1e-6)
    np.testing.assert_allclose(second.load_frames().mean(axis=(1, 2, 3)), colours[1], atol=8)


@pytest.mark.parametrize(
    "file", ["meta/info.json", "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"]
)
def test_damaged_lerobot_is_refused(file: str, tmp_path: Path) -> None:
    folder = so101(tmp_path / "so101", np.zeros((2, 12, 2)), np.zeros((2, 12)))
    content = (folder / file).read_bytes()
    (folder / file).write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="so101"):
        list(open_data_set(folder))


def rrd_columns(chunks: Any) -> dict[str, np.ndarray]:
    """All numbers in chunks of Rerun, by entity and component."""
    out: dict[str, np.ndarray] = {}
    for chunk in chunks.stream().to_chunks():
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if "Scalars" in name:
                values = np.array([row.as_py() for row in column], float).ravel()
                path = f"{chunk.entity_path}"
                out[path] = np.concatenate([out.get(path, np.empty(0)), values])
    return out


def test_rerun_file_holds_every_signal(tmp_path: Path, make_recording: Make) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    keypoints = np.random.default_rng(3).uniform(0, 9, (8, 1, 2))
    recording = make_recording(0, keypoints=keypoints)
    report = {"headline": "Friction is missing.", "verdict": "mismatch", "findings": []}
    (tmp_path / "report.json").write_text(json.dumps(report))
    out = export(tmp_path, "rerun", recording, more=("--diagnosis", str(tmp_path)))
    store = RrdReader(out / "run-00.rrd").store()
    found = rrd_columns(store)
    assert recording.qpos is not None and recording.action is not None
    np.testing.assert_array_equal(found["/qpos/hinge"], recording.qpos[:, 1])
    np.testing.assert_array_equal(found["/action/slide"], recording.action[:, 0])
    assert {"/camera", "/camera/keypoints", "/diagnosis", "/qvel/slider"} <= set(store.schema().entity_paths())


def mcap(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """A log of ROS 2 joint states whose stamps are earlier than their recording, and of commands in JSON."""
    writer = pytest.importorskip("mcap_ros2.writer")
    from mcap.writer import Writer

    rng, start = np.random.default_rng(4), 1_700_000_000 * 10**9
    stamps = start + 10**7 * np.arange(20) + rng.integers(0, 10**6, 20)
    position = rng.normal(size=(20, 2))
    with open(path, "wb") as file:
        ros = writer.Writer(file)
        time = "builtin_interfaces/Time stamp\nstring frame_id\n"
        separator = "=" * 80
        text = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
        text += f"{separator}\nMSG: std_msgs/Header\n{time}{separator}\nMSG: builtin_interfaces/Time\n"
        camera = ros.register_msgdef("camera/msg/Picture", "uint8[] data\nfloat64 exposure\n")
        picture = {"data": bytes(5000), "exposure": 0.01}
        ros.write_message("/camera", camera, picture, start + 10**9, start + 10**9)
        schema = ros.register_msgdef("sensor_msgs/msg/JointState", f"{text}int32 sec\nuint32 nanosec\n")
        for i, stamp in enumerate(stamps):
            order = [0, 1] if i % 2 else [1, 0]  # a publisher may change it
            message = {
                "header": {"stamp": {"sec": int(stamp // 10**9), "nanosec": int(stamp % 10**9)}, "frame_id": ""},
                "name": [("elbow", "wrist")[j] for j in order],
                "position": position[i, order].tolist(),
                "velocity": [],
                "effort": [],
            }
            ros.write_message("/joint_states", schema, message, int(stamp) + 3 * 10**6, int(stamp) + 2 * 10**6)
        ros.finish()
    commands = path.with_name("commands.mcap")
    with open(commands, "wb") as file:
        plain = Writer(file)
        plain.start()
        channel = plain.register_channel("/command", "json", plain.register_schema("command", "jsonschema", b"{}"))
        for i in range(10):
            plain.add_message(channel, start + i, json.dumps({"torque": [i, -i]}).encode(), start + 10**6 * i)
        plain.finish()
    return (stamps - start) * 1e-9, position


def test_mcap_joint_states_keep_the_sensors_clock(tmp_path: Path) -> None:
    clock, position = mcap(tmp_path / "log.mcap")
    words = ["--time", "/joint_states.time", "--joint", "elbow=/joint_states.position.elbow"]
    words += ["--joint", "wrist=/joint_states.position.wrist"]
    assert main(["import", str(tmp_path / "log.mcap"), "--out", str(tmp_path / "rec"), *words]) == 0
    recording = read_recording(tmp_path / "rec")
    assert recording.t_state is not None
    np.testing.assert_allclose(recording.t_state, clock - clock[0], atol=1e-12)
    np.testing.assert_array_equal(recording.qpos, position)
    table = read_mcap(tmp_path / "log.mcap")
    assert [name for name in table.columns if name.startswith("/camera")] == [
        "/camera.time",
        "/camera.log_time",
        "/camera.exposure",
    ]
    np.testing.assert_allclose(table.column("/joint_states.log_time") - recording.t_state, 3e-3, atol=1e-12)


def test_mcap_in_json(tmp_path: Path) -> None:
    mcap(tmp_path / "log.mcap")
    table = read_mcap(tmp_path / "commands.mcap")
    np.testing.assert_array_equal(table.column("/command.torque[1]"), -np.arange(10.0))
    np.testing.assert_allclose(table.column("/command.time"), 1e-3 * np.arange(10), atol=1e-12)


def test_damaged_mcap_is_refused(tmp_path: Path) -> None:
    mcap(tmp_path / "log.mcap")
    content = (tmp_path / "log.mcap").read_bytes()
    for damaged in (b"", b"no MCAP at all", content[:300], content[:-40], content[:200] + bytes(80) + content[280:]):
        (tmp_path / "bad.mcap").write_bytes(damaged)
        with pytest.raises(InputError, match=r"bad\.mcap"):
            read_mcap(tmp_path / "bad.mcap")


@pytest.mark.parametrize(
    "to, module, extra",
    [
        ("minari", "minari.data_collector", "minari"),
        ("lerobot", "pyarrow.parquet", "lerobot"),
        ("rerun", "rerun", "rerun"),
    ],
)
def test_a_missing_package_is_named(
    to: str, module: str, extra: str, tmp_path: Path, make_recording: Make,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    write_recording(tmp_path / "in/a", make_recording(0))
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["export", str(tmp_path / "in"), "--to", to, "--out", str(tmp_path / "out")]) == 2
    assert f"'keycld[{extra}]'" in capsys.readouterr().err
