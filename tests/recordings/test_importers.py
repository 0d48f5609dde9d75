"""Files of other programs become recordings, and what cannot is named by file, column and line."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import io

from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.recordings import read_dataset, read_recording
from keycld_envs.recordings.importers import (
    Columns,
    Table,
    assemble,
    is_epos,
    read_csv,
    read_epos,
    read_json_log,
    read_mat,
)

COLUMNS = Columns("t", {"hinge": "angle"}, {"hinge": "speed"}, {"motor": "torque"})


def write(tmp_path: Path, text: str, encoding: str = "utf-8") -> Path:
    path = tmp_path / "log.csv"
    path.write_text(text, encoding=encoding)
    return path


@pytest.mark.parametrize(
    "text, encoding",
    [
        ("t,angle\n0,1.5\n0.1,\n0.3,NaN\n", "utf-8"),
        ("t; angle\n0; 1.5\n0.1; nan\n0.3; \n", "utf-8-sig"),
        ("# a comment\nt\tangle\n0\t1.5\n\n0.1\tNA\n0.3\t-\n", "utf-8"),
        ('"t","angle"\r\n0,"1.5"\r\n0.1,null\r\n0.3,n/a\r\n', "utf-8"),
    ],
)
def test_csv_of_any_dialect(tmp_path: Path, text: str, encoding: str) -> None:
    table = read_csv(write(tmp_path, text, encoding))
    np.testing.assert_array_equal(table.column("t"), [0, 0.1, 0.3])
    np.testing.assert_array_equal(table.column("angle"), [1.5, np.nan, np.nan])


def test_columns_without_a_header_and_the_end_of_a_killed_logger(tmp_path: Path) -> None:
    path = write(tmp_path, "0 1\n0.1 2\n0.2")
    table = read_csv(path, ["t", "angle"], drop_truncated_end=True)
    np.testing.assert_array_equal(table.column("angle"), [1, 2])
    with pytest.raises(InputError, match=r"log.csv, line 3 is truncated: it has 1 of 2 cells"):
        read_csv(path, ["t", "angle"])
    with pytest.raises(InputError, match=r"line 1: the header holds numbers; .* --columns"):
        read_csv(path)


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "log.csv is empty"),
        ("t,angle\n", "no rows"),
        ("t,t\n0,1\n", "two columns are named 't'"),
        ("t,angle\n0,1\n\n0.1,1e\n", r"log.csv, line 4, column 'angle': '1e' is no number"),
        ("t;angle\n0,1;1\n", r"line 2, column 't': '0,1' is no number; write it with a decimal point"),
        ("t,angle\n0,1\n0.1,1,2\n", r"line 3 is too long: it has 3 of 2 cells"),
        ("t,angle\n0,1\n0.1\n0.2,1\n", r"line 3 is truncated"),
    ],
)
def test_damaged_csv_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_csv(write(tmp_path, text), drop_truncated_end=True)


def test_files_that_are_none(tmp_path: Path) -> None:
    binary = tmp_path / "log.bin"
    binary.write_bytes(b"\xff\xfe\x00\x01" * 50)
    for read, message in ((read_csv, "UTF-8 text"), (read_mat, "damaged or no MATLAB file")):
        with pytest.raises(InputError, match=message):
            read(binary)
        with pytest.raises(InputError, match="does not exist"):
            read(tmp_path / "nothing")


def test_a_recording_keeps_its_clock_converts_units_and_unwraps(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "t,angle,speed,torque,wall\n0,170,1,250,5\n10,179,2,250,\n10,,,250,\n35,-178,3,0,\n",
    )
    units = {"t": "ms", "angle": "deg", "speed": "rpm", "torque": "mN m"}
    columns = Columns("t", {"hinge": "angle"}, {"hinge": "speed"}, {"motor": "torque"}, units=units)
    recording = assemble(read_csv(path), columns, "a", licence="MIT")
    np.testing.assert_allclose(np.asarray(recording.t_state), [0, 0.01, 0.01, 0.035])
    np.testing.assert_allclose(np.rad2deg(np.asarray(recording.qpos)[:, 0]), [170, 179, np.nan, 182])
    np.testing.assert_allclose(np.asarray(recording.qvel)[:, 0], np.array([1, 2, np.nan, 3]) * np.pi / 30)
    np.testing.assert_allclose(np.asarray(recording.action)[:, 0], [0.25, 0.25, 0.25, 0])
    assert recording.units == {"qpos": ("rad",), "qvel": ("rad/s",), "action": ("N m",)}
    assert (recording.source, recording.licence, recording.origin) == ("real", "MIT", "log.csv")


def test_a_slide_in_metres_is_not_unwrapped_and_its_speed_is_in_metres_too() -> None:
    table = Table(Path("x.csv"), {"t": np.arange(3.0), "x": np.array([0.0, 500, 0]), "v": np.ones(3)})
    recording = assemble(table, Columns("t", {"cart": "x"}, {"cart": "v"}, units={"x": "cm"}), "a")
    np.testing.assert_allclose(np.asarray(recording.qpos)[:, 0], [0, 5, 0])
    assert recording.units == {"qpos": ("m",), "qvel": ("m/s",)}


def test_a_factor_before_a_unit_is_that_of_a_gear() -> None:
    table = Table(Path("x.csv"), {"t": np.arange(3.0), "q": np.array([0.0, 90, 180]), "u": np.array([1.0, 0, -1])})
    columns = Columns("t", {"a": "q"}, actions={"a": "u"}, units={"q": "0.01 rev", "u": "250 mN m"})
    recording = assemble(table, columns, "a")
    np.testing.assert_allclose(np.asarray(recording.qpos)[:, 0], 2 * np.pi * np.array([0, 0.9, 1.8]))
    np.testing.assert_allclose(np.asarray(recording.action)[:, 0], [0.25, 0, -0.25])
    assert recording.units == {"qpos": ("rad",), "action": ("N m",)}


def test_a_missing_command_is_refused_unless_the_one_before_holds() -> None:
    table = Table(Path("x.csv"), {"t": np.arange(3.0), "q": np.zeros(3), "u": np.array([1.0, np.nan, 2.0])}, (2, 3, 4))
    strict = Columns("t", {"hinge": "q"}, actions={"motor": "u"})
    holding = replace(strict, hold=True)
    with pytest.raises(InputError, match=r"x.csv, line 3, column 'u': the command is missing"):
        assemble(table, strict, "a")
    held = assemble(table, holding, "a")
    np.testing.assert_array_equal(np.asarray(held.action)[:, 0], [1, 1, 2])
    first = Table(Path("x.csv"), {**table.columns, "u": np.array([np.nan, 1.0, 2.0])}, table.lines)
    with pytest.raises(InputError, match="line 2, column 'u'"):
        assemble(first, holding, "a")


@pytest.mark.parametrize(
    "changed, columns, message",
    [
        ({}, Columns("time", {"hinge": "q"}), r"no column 'time'; there are t, q, u"),
        ({"t": [0.0, 2.0, 1.0]}, Columns("t", {"hinge": "q"}), r"line 4, column 't': 1 s comes after 2 s"),
        ({"t": [0.0, np.nan, 1.0]}, Columns("t", {"hinge": "q"}), r"line 3, column 't': the time is missing"),
        ({"q": [0.0, np.inf, 1.0]}, Columns("t", {"hinge": "q"}), r"line 3, column 'q': inf is no measurement"),
        ({"q": [0.0, 1.0]}, Columns("t", {"hinge": "q"}), r"'q' has 2 values, its clock 't' has 3"),
        ({}, Columns("t", {}), "no joint has a column"),
        ({}, Columns("t", {"hinge": "q"}, {"knee": "q"}), r"velocities are named for \['knee'\]"),
        ({}, Columns("t", {"hinge": "q"}, units={"q": "furlong"}), "unit 'furlong' of 'q' is unknown"),
        ({}, Columns("t", {"hinge": "q"}, units={"q": "0 rad"}), "unit '0 rad' of 'q' is unknown"),
        ({}, Columns("t", {"hinge": "q"}, units={"q": "two rad"}), "unit 'two rad' of 'q' is unknown"),
        ({}, Columns("t", {"hinge": "q"}, units={"t": "deg"}), "'t' is a clock, which is not in 'deg'"),
        ({}, Columns("t", {"hinge": "q"}, units={"q": "N m"}), "'q' is a joint's position, which is not in 'N m'"),
        ({"q": [0.0, 6.0, 12.6]}, Columns("t", {"hinge": "q"}), "may be degrees; say .*, --unit q=deg"),
        ({"q": [np.nan] * 3}, Columns("t", {"hinge": "q"}), "column 'q' holds no number"),
        (
            {"t": 20.0 * np.arange(20), "q": np.zeros(20)},
            Columns("t", {"hinge": "q"}),
            "column 't': a row every 20 may be of ms, us or ns; say .*, --unit t=ms",
        ),
        ({"q": [350.0, 356.0, 2.0]}, Columns("t", {"hinge": "q"}), "may be degrees; say which unit they have"),
    ],
)
def test_what_cannot_be_a_recording_is_refused(changed: dict, columns: Columns, message: str) -> None:
    values = {"t": [0.0, 1.0, 2.0], "q": [0.0, 1.0, 2.0], "u": [0.0, 0.0, 0.0]} | changed
    table = Table(Path("x.csv"), {name: np.array(column) for name, column in values.items()}, (2, 3, 4))
    with pytest.raises(InputError, match=message):
        assemble(table, columns, "a")


def test_mat_with_matrices_cells_structures_and_a_clock_of_the_actions(tmp_path: Path) -> None:
    t = 0.001 * np.arange(5)
    cells = np.empty(2, object)
    cells[:] = [np.stack([t, 2 * t]), 3 * t[:, None]]
    path = tmp_path / "log.mat"
    io.savemat(path, {"T": t, "Y": cells, "s": {"u": t[:3] + 1, "tu": t[:3]}, "note": "words", "dt": 0.001})
    table = read_mat(path)
    assert set(table.columns) == {"T", "Y{0}[0]", "Y{0}[1]", "Y{1}", "s.u", "s.tu", "dt"}
    np.testing.assert_array_equal(table.column("Y{0}[1]"), 2 * t)
    recording = assemble(
        table, Columns("T", {"a": "Y{0}[0]", "b": "Y{1}"}, actions={"m": "s.u"}, action_time="s.tu"), "x"
    )
    assert (np.asarray(recording.qpos).shape, np.asarray(recording.action).shape) == ((5, 2), (3, 1))
    np.testing.assert_array_equal(np.asarray(recording.t_action), t[:3])


def test_mat_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM"
    path.write_bytes(header.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n")
    with pytest.raises(InputError, match=r"v7.3 file \(HDF5\); save it .* '-v7'"):
        read_mat(path)
    io.savemat(path, {"note": "words"})
    with pytest.raises(InputError, match="holds no numeric arrays"):
        read_mat(path)
    io.savemat(path, {"x": np.arange(1000.0)})
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(InputError, match="damaged or no MATLAB file"):
        read_mat(path)


def test_the_command_writes_a_recording_or_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, "t,a,b,u\n0,0,90,1\n0.1,1,91,\n0.2,2,92,2\n")
    words = ["import", str(path), "--out", str(tmp_path / "r"), "--time", "t", "--joint", "shoulder=a"]
    words += ["--joint", "elbow=b", "--action", "motor=u", "--unit", "b=deg", "--licence", "MIT", "--json"]
    assert main(words) == 2
    assert "line 3, column 'u': the command is missing" in capsys.readouterr().err
    assert not (tmp_path / "r").exists()
    assert main([*words, "--hold"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == 3
    recording = read_recording(tmp_path / "r")
    assert recording.joint_names == ("shoulder", "elbow")
    np.testing.assert_allclose(np.asarray(recording.qpos)[:, 1], np.deg2rad([90, 91, 92]))
    assert main([*words, "--hold", "--system", "acrobt"]) == 2
    assert "acrobot" in capsys.readouterr().err
    assert main([*words, "--hold", "--joint", "elbow"]) == 2
    assert "--joint 'elbow' is not NAME=COLUMN" in capsys.readouterr().err


@pytest.mark.parametrize(
    "content",
    [
        '{"kp": 4, "rows": [{"t": 0, "m": {"q": 1}, "on": true}, {"t": 0.5, "m": {"q": 2}, "on": false, "mode": "x"}]}',
        '[{"t": 0, "m": {"q": 1}, "on": 1, "kp": 4}, {"t": 0.5, "m": {"q": 2}, "on": 0, "kp": 4.0}]',
        '{"t": 0, "m": {"q": 1}, "on": 1, "kp": 4}\n{"t": 0.5, "m": {"q": 2}, "on": 0, "kp": 4}\n',
        '{"t": [0, 0.5], "m.q": [1, 2], "on": [true, false], "kp": 4}',
    ],
)
def test_json_logs_of_any_form(tmp_path: Path, content: str) -> None:
    (tmp_path / "log.json").write_text(content)
    table = read_json_log(tmp_path / "log.json")
    assert set(table.columns) == {"t", "m.q", "on", "kp"}
    for name, values in {"t": [0, 0.5], "m.q": [1, 2], "on": [1, 0], "kp": [4, 4]}.items():
        np.testing.assert_array_equal(table.column(name), values)


def test_what_a_sample_lacks_is_nan_and_lists_have_indices(tmp_path: Path) -> None:
    (tmp_path / "log.json").write_text('[{"t": 0, "q": [1, 2]}, {"t": 1}, {"t": 2, "q": [3, null]}]')
    table = read_json_log(tmp_path / "log.json")
    np.testing.assert_array_equal(table.column("q[0]"), [1, np.nan, 3])
    np.testing.assert_array_equal(table.column("q[1]"), [2, np.nan, np.nan])


@pytest.mark.parametrize(
    "content, message",
    [
        ("", "cannot be read as a log"),
        ('{"t": [0, 1', "cannot be read as a log"),
        ("3", "neither an object nor a list"),
        ("[]", "holds no samples"),
        ('{"kp": 4}', "holds no samples"),
        ("[1, 2]", "sample 0 is no object"),
        ('{"a": [{"t": 0}], "b": [{"t": 0}]}', "two lists of samples, 'a' and 'b'"),
        ('{"t": [1' + "0" * 400 + "]}", "a number is too large"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_json_that_is_no_log_is_refused(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "log.json").write_text(content)
    with pytest.raises(InputError, match=rf"log.json .*{message}"):
        read_json_log(tmp_path / "log.json")


EPOS = '''Date:;2020-07-08 22:13:00\r
EPOS Studio Version:;3.6.1.0\r
Sampling period:;500.000\r
"Trigger:;0;0.000000;""Parameter values"";""Channel 1"";""Rising above value"""\r
;Velocity actual value averaged;Torque actual value averaged\r
ms;rpm;%\r
0.000;0;0.0\r
500.000;60;12.5\r
1000.000;60;-12.5\r
'''


def test_epos_tells_its_units_and_a_speed_is_added_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "drive.csv").write_bytes(EPOS.encode())
    speed = "screw=Velocity actual value averaged"
    words = ["--time", "time", "--joint", speed, "--velocity", speed, "--action", "m=Torque actual value averaged"]
    assert main(["import", str(tmp_path / "drive.csv"), "--out", str(tmp_path / "out"), *words, "--json"]) == 0
    recording = read_recording(tmp_path / "out")
    assert recording.units == {"qpos": ("rad",), "qvel": ("rad/s",), "action": ("1",)}
    assert recording.t_state is not None and recording.qvel is not None
    assert recording.qpos is not None and recording.action is not None
    np.testing.assert_allclose(recording.t_state, [0, 0.5, 1])
    np.testing.assert_allclose(recording.qvel[:, 0], [0, 2 * np.pi, 2 * np.pi])
    np.testing.assert_allclose(recording.qpos[:, 0], [0, np.pi / 2, 3 * np.pi / 2])
    np.testing.assert_allclose(recording.action[:, 0], [0, 0.125, -0.125])
    (tmp_path / "drive.csv").write_bytes(EPOS.replace("ms;rpm;%", "x;y;z").encode())
    assert main(["import", str(tmp_path / "drive.csv"), "--out", str(tmp_path / "no"), *words]) == 2
    assert "no line of units" in capsys.readouterr().err


def test_what_is_no_text_was_not_written_by_epos(tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_bytes(b"Date:;\xff\xfe\n")
    assert not is_epos(tmp_path / "drive.csv") and not is_epos(tmp_path / "none.csv")
    for name in ("drive.csv", "none.csv"):
        with pytest.raises(InputError, match=name):
            read_epos(tmp_path / name)


@pytest.mark.parametrize("wrong", [{"time": 3}, {"joints": ["q"]}, {"units": {"q": 1}}])
def test_columns_are_named_by_words(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        Columns(**{"time": "t", "joints": {"hinge": "q"}} | wrong)


def test_a_speed_with_gaps_is_not_added_up() -> None:
    table = Table(Path("log.csv"), {"t": np.arange(3.0), "v": np.array([1, np.nan, 1])}, (2, 3, 4))
    with pytest.raises(InputError, match=r"log.csv, line 3: a speed is missing"):
        assemble(table, Columns("t", {"hinge": "v"}, units={"v": "rpm"}), "id")


@pytest.mark.parametrize(
    "words, said",
    [
        (["nope.mp4", "--mechanism", "swing.py"], "nope.mp4 does not exist; name a log, a video"),
        (["nope.csv"], "nope.csv does not exist"),
        (["swing.py"], "swing.py is a Python file, not a recording; name a log, a video"),
        (["arm.xml", "--time", "t"], "arm.xml is a mechanism's description (`keycld new --mjcf` takes it), not"),
        (["check.png"], "check.png is a picture, not a recording"),
        (
            ["cut.csv", "--time", "t", "--joint", "hinge=q"],
            "line 4 is truncated: it has 1 of 2 cells; remove this last",
        ),
        (["cut.csv", "--time", "t", "--joint", "hinge=q"], "have `keycld import` leave it out, --drop-truncated-end."),
    ],
)
def test_what_cannot_be_imported(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("arm.xml", "check.png"):
        Path(name).write_text("<mujoco/>")
    Path("swing.py").write_text(
        "from keycld_envs import Mechanism, Rod\nmechanism = Mechanism(1, 0, (Rod(None, 0),))\n"
    )
    Path("cut.csv").write_text("t,q\n0,1\n0.1,2\n0.2")
    assert main(["import", *words, "--out", "data"]) == 2
    assert said in capsys.readouterr().err
    assert not Path("data").exists()


def test_several_logs_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for i in range(3):
        rows = "".join(f"{0.1 * k},{i + k}\n" for k in range(4))
        (tmp_path / f"log-{i}.csv").write_text("t,angle\n" + rows)
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "log-0.csv").write_text("t,angle\n0,0\n1,1\n")
    (tmp_path / "bad.csv").write_text("t,angel\n0,0\n1,1\n")
    logs, out = [str(tmp_path / f"log-{i}.csv") for i in range(3)], tmp_path / "data"
    words = ["--out", str(out), "--time", "t", "--joint", "hinge=angle"]
    for other, said in (("bad.csv", "angle"), ("more/log-0.csv", "Several files")):
        assert main(["import", *logs, str(tmp_path / other), *words]) == 2
        assert said in capsys.readouterr().err
        assert not out.exists()  # all or none
    assert main(["import", *logs, *words, "--json"]) == 0
    assert [r["samples"] for r in json.loads(capsys.readouterr().out)["recordings"]] == [4, 4, 4]
    read = read_dataset(out)
    assert [r.id for r in read.recordings] == ["log-0", "log-1", "log-2"]
    for i, recording in enumerate(read.recordings):
        assert recording.qpos is not None and recording.qpos[:, 0].tolist() == [i, i + 1, i + 2, i + 3]
    assert main(["import", *logs, *words]) == 2
    assert "exists" in capsys.readouterr().err
