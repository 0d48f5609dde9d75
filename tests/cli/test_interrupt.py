"""Ctrl-C, wherever it comes: exit code 130, soon, and nothing left over."""

import os
import signal
import subprocess
import sys
import time

import pytest

from keycld_model.stored import shipped_models

pytestmark = [
    pytest.mark.slow,
    pytest.mark.render,
    pytest.mark.skipif(os.name != "posix", reason="sends signals"),
]
COMMANDS = {
    "collect": ["collect", "pendulum", "--out", "{}/data", "--episodes", "2000", "--workers", "2"],
    "swingup": ["swingup", "pendulum", "--episodes", "100", "--workers", "2"],
    "blind": ["blind", "make", "{}/blind", "--cases", "50", "--workers", "2"],
}


def descendants(pid: int) -> list[int]:
    """Processes that a process has started, and theirs."""
    out = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True).stdout
    pairs = [tuple(map(int, line.split())) for line in out.splitlines()]
    found, more = [], [pid]
    while more:
        more = [child for child, parent in pairs if parent in more]
        found += more
    return found


def alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("seconds", [0.7, 3.0])
@pytest.mark.parametrize("name", COMMANDS)
def test_it_ends_at_once(name, seconds, tmp_path):
    if name == "swingup" and "pendulum" not in shipped_models():
        pytest.skip("no weights in this installation")
    words = [word.format(tmp_path) for word in COMMANDS[name]]
    command = [sys.executable, "-m", "keycld_control", *words]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, start_new_session=True, **pipes) as process:
        time.sleep(seconds)
        workers = descendants(process.pid)
        for _ in range(3):  # who is impatient presses again
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the command and its workers
            time.sleep(0.05)
        begun = time.monotonic()
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 130, errors
        assert "keycld: interrupted" in errors.splitlines()
        assert "Traceback" not in errors
        assert time.monotonic() - begun < 10  # 3 s on a machine that does nothing else
        ended = time.monotonic()
        while left := [pid for pid in workers if alive(pid)]:
            assert time.monotonic() - ended < 1.0, left
            time.sleep(0.02)
