"""Atomic writes and the progress bar."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from keycld_envs.files import atomic_file, atomic_folder, one_writer, partial_path


def test_a_file_is_replaced_only_when_complete(tmp_path: Path) -> None:
    path = tmp_path / "new" / "log.json"
    with atomic_file(path, "w") as file:
        file.write("größer")
        assert not path.exists()
    assert path.read_text(encoding="utf-8") == "größer"
    with pytest.raises(RuntimeError), atomic_file(path) as file:
        file.write(b"half")
        raise RuntimeError
    assert path.read_text(encoding="utf-8") == "größer"
    with atomic_file(path) as file:
        file.write(b"\x00\x01")
    assert path.read_bytes() == b"\x00\x01"
    assert list(path.parent.iterdir()) == [path]


def test_a_folder_appears_only_when_complete(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), atomic_folder(tmp_path / "a") as folder:
        (folder / "x").touch()
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "a").mkdir()
    with atomic_folder(tmp_path / "a") as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "x").touch()
    assert (tmp_path / "a" / "sub" / "x").exists()
    with pytest.raises(FileExistsError), atomic_folder(tmp_path / "a"):
        pass


def test_an_interrupted_writer_leaves_nothing_that_its_ended_workers_had_begun(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), one_writer(tmp_path):
        (tmp_path / "done").mkdir()
        for begun in (partial_path(tmp_path / "b"), partial_path(tmp_path / "c")):
            begun.mkdir()
            (begun / "frames.npy").touch()
        partial_path(tmp_path / "log.json").touch()
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.glob("*") if not path.name.endswith(".lock")] == ["done"]
    with one_writer(tmp_path):
        partial_path(tmp_path / "d").touch()
    assert partial_path(tmp_path / "d").exists()  # somebody else's, perhaps: nothing went wrong here


def test_progress_shows_on_a_terminal_only() -> None:
    code = (
        "from keycld_envs.progress import progress\n"
        "with progress('Baking', total=3) as advance:\n"
        "    advance(2); advance(1, note='loss 0.5')"
    )
    silent = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert silent.stdout == silent.stderr == b""
    terminal, end = os.openpty()
    env = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=end, env=env, check=True)
    shown = os.read(terminal, 10000).decode()
    os.close(end)
    os.close(terminal)
    assert done.stdout == b""
    for part in ("Baking", "3/3", "loss 0.5"):
        assert part in shown
