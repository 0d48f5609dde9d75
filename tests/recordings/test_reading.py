"""Files of others: what cannot be read is refused in one sentence, without filling the memory and without waiting."""

import io
import json
import os
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy import io as scipy_io

from keycld_envs.errors import InputError
from keycld_envs.reading import VARIABLE, check_file, read_arrays, read_json, read_limit
from keycld_envs.recordings import Recording, read_recording, write_recording
from keycld_envs.recordings.importers import read_csv, read_mat
from keycld_envs.recordings.video import iter_video

MAGIC = b"\x93NUMPY\x01\x00"


def npy(header: str, content: bytes = b"", magic: bytes = MAGIC) -> bytes:
    """An array's file with a header that claims what it likes."""
    text = header.encode() + b"\n"
    return magic + struct.pack("<H", len(text)) + text + content


def claim(shape: str, descr: str = "'<f8'") -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"


def npz(path: Path, content: bytes, compression: int = zipfile.ZIP_DEFLATED, name: str = "qpos.npy") -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr(name, content)
    return path


def test_arrays_come_back_as_numpy_wrote_them(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "a": rng.normal(size=(3, 4)), "fortran": np.asfortranarray(rng.normal(size=(3, 4))),
        "frames": rng.integers(0, 255, (2, 5, 7, 3)).astype(np.uint8),
        "none": np.zeros((0, 2)), "scalar": np.array(2.0),
    }  # fmt: skip
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "x.npz", **arrays)
        found = read_arrays(tmp_path / "x.npz")
        assert found.keys() == arrays.keys()
        for name, array in arrays.items():
            assert found[name].dtype == array.dtype
            np.testing.assert_array_equal(found[name], array)


@pytest.mark.parametrize(
    "content",
    [
        npy(claim("(1000000000,)")),
        npy(claim("(10**18,)")),
        npy(claim("(1000000000000000000,)"), b"\0" * 80),
        npy(claim("(-3,)"), b"\0" * 24),
        npy(claim("(3,)"), b"\0" * 23),
        npy(claim("(3,)"), b"\0" * 32),
        npy(claim("(1,)", "'(1000000000,)f8'"), b"\0" * 8),
        npy(claim("(1,)", "'|O'"), b"\0" * 8),
        npy(claim("[" * 9000 + "]" * 9000)),
        npy(claim("(3, 16ape")),
        npy(claim("(3,)"), b"\0" * 24, b"\x93NUMPY\x07\x00"),
        b"no array",
        b"",
    ],
)
def test_headers_that_claim_what_is_not_there(tmp_path, content):
    with pytest.raises(ValueError):
        read_arrays(npz(tmp_path / "x.npz", content))


def test_a_small_file_that_would_fill_the_memory(tmp_path):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("qpos.npy", "w") as entry:
        entry.write(npy(claim("(100000000,)")))
        for _ in range(800):
            entry.write(bytes(1_000_000))
    assert path.stat().st_size < 2_000_000
    with pytest.raises(ValueError, match=rf"0\.8 GB of memory, more than 0\.75 GB; .*{VARIABLE}"):
        read_arrays(path)


def test_the_limit_is_a_setting(tmp_path, monkeypatch):
    np.savez(tmp_path / "x.npz", a=np.zeros(200_000))
    monkeypatch.setenv(VARIABLE, "0.001")
    with pytest.raises(ValueError, match=VARIABLE):
        read_arrays(tmp_path / "x.npz")
    monkeypatch.setenv(VARIABLE, "0.01")
    assert read_arrays(tmp_path / "x.npz")["a"].shape == (200_000,)
    for wrong in ("much", "-1", "nan", "0"):
        monkeypatch.setenv(VARIABLE, wrong)
        with pytest.raises(ValueError, match="positive number of GB"):
            read_limit()


def test_archives_that_numpy_does_not_write(tmp_path):
    good = io.BytesIO()
    np.save(good, np.zeros(3))
    for compression in (zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2):
        with pytest.raises(ValueError, match="compressed in a way"):
            read_arrays(npz(tmp_path / "x.npz", good.getvalue(), compression))
    path = npz(tmp_path / "encrypted.npz", good.getvalue())
    content = bytearray(path.read_bytes())
    content[6] |= 1  # the flag of encryption, in the entry and in the directory
    content[content.rfind(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="encrypted"):
        read_arrays(path)
    with zipfile.ZipFile(tmp_path / "many.npz", "w") as archive:
        for i in range(1001):
            archive.writestr(f"{i}.npy", good.getvalue())
    with pytest.raises(ValueError, match="more than 1000 arrays"):
        read_arrays(tmp_path / "many.npz")


def test_every_flipped_byte_of_a_recording_is_noticed_or_harmless(tmp_path):
    """Zip has no checksum of its own directory; what is accepted in spite of a flip is the same recording."""
    qpos = np.random.default_rng(0).normal(size=(30, 1))
    recording = Recording(
        id="a", source="real", joint_names=("hinge",), units={"qpos": "rad"}, t_state=np.arange(30.0), qpos=qpos
    )
    write_recording(tmp_path / "a", recording)
    path = tmp_path / "a" / "signals.npz"
    whole, rng = path.read_bytes(), np.random.default_rng(1)
    for at in rng.integers(0, len(whole), 150):
        damaged = bytearray(whole)
        damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            again = read_recording(tmp_path / "a")
        except InputError:
            continue
        np.testing.assert_array_equal(np.asarray(again.qpos), qpos)


def test_json_that_is_nested_too_deeply(tmp_path):
    path = tmp_path / "x.json"
    path.write_text("[" * 100_000 + "]" * 100_000)
    with pytest.raises(ValueError, match="nested too deeply"):
        read_json(path)
    path.write_text(json.dumps({"a": [1, None]}))
    assert read_json(path) == {"a": [1, None]}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="makes a named pipe")
@pytest.mark.parametrize("read", [check_file, read_json, read_arrays])
def test_pipes_devices_and_folders_are_no_files(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ValueError, match="pipe or a device"):
            read(path)
    with pytest.raises(ValueError, match="folder"):
        read(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="makes a named pipe")
@pytest.mark.parametrize("name", ["meta.json", "signals.npz", "frames.npz", "frames.mkv"])
def test_a_recording_with_a_pipe_in_it_is_refused(tmp_path, name):
    t = np.arange(3.0)
    write_recording(
        tmp_path / "a",
        Recording(id="a", source="real", joint_names=("h",), units={"qpos": "rad"}, t_state=t, qpos=t[:, None],
                  t_frame=t, frames=np.zeros((3, 8, 8, 3), np.uint8)),
    )  # fmt: skip
    if name.startswith("frames"):
        (tmp_path / "a" / "frames.npz").unlink()
    (tmp_path / "a" / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / "a" / name)
    with pytest.raises(InputError, match=rf"{name} .*pipe or a device"):
        read_recording(tmp_path / "a")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="makes a named pipe")
def test_tables_and_videos_are_files_too(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for read in (read_csv, read_mat, lambda path: list(iter_video(path, 1))):
        for path in (tmp_path / "pipe", Path("/dev/zero")):
            with pytest.raises(InputError, match="pipe or a device"):
                read(path)


@pytest.mark.parametrize(
    "text, message",
    [
        ("t,q\n0," + "1" * 200_000 + "\n", "field larger than field limit"),
        ("t q\n0 " + "1" * (1 << 24) + "\n", "line 2 has more than 16,777,216 characters"),
    ],
)
def test_cells_and_lines_that_do_not_end(tmp_path, text, message):
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_csv(tmp_path / "x.csv")


def test_a_table_of_very_many_columns(tmp_path):
    names = [f"c{i}" for i in range(60_000)]
    (tmp_path / "x.csv").write_text(",".join(names) + "\n" + ",".join(map(str, range(60_000))) + "\n")
    table = read_csv(tmp_path / "x.csv")
    assert len(table.columns) == 60_000 and table.column("c59999")[0] == 59_999
    with pytest.raises(InputError) as caught:
        table.column("d")
    assert len(str(caught.value)) < 500


def test_matlab_files_that_are_empty_or_would_fill_the_memory(tmp_path):
    path = tmp_path / "x.mat"
    path.write_bytes(b"")
    with pytest.raises(InputError, match="damaged or no MATLAB file"):
        read_mat(path)
    scipy_io.savemat(path, {"x": np.arange(3.0)})
    packer = zlib.compressobj(9)
    bomb = b"".join(packer.compress(bytes(1_000_000)) for _ in range(800)) + packer.flush()
    path.write_bytes(path.read_bytes()[:128] + struct.pack("<II", 15, len(bomb)) + bomb)
    with pytest.raises(InputError, match=VARIABLE):
        read_mat(path)
