"""Training on several devices, and in several processes: the same losses as on one."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.long
SCRIPT = Path(__file__).parent / "sharded.py"


def start(folder, *where, devices=1, stages=4):
    flags = f"--xla_force_host_platform_device_count={devices}"
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, str(SCRIPT), str(folder), str(stages), *where]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def end(process):
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return out.strip().splitlines()[-1]


def losses(folder):
    entries = map(json.loads, (folder / "log.jsonl").read_text().splitlines())
    return np.array([entry["loss"] for entry in entries if "loss" in entry])


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    assert end(start(folder)) == "1 processes, 1 devices"
    return losses(folder)


def test_two_devices(alone, tmp_path):
    assert end(start(tmp_path, devices=2, stages=2)) == "1 processes, 2 devices"
    np.testing.assert_allclose(losses(tmp_path), alone[:6], rtol=2e-4)


def test_two_processes_over_gloo(alone, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    processes = [start(tmp_path, address, str(i)) for i in range(2)]
    assert [end(process) for process in processes] == ["2 processes, 2 devices"] * 2
    assert len(alone) == 11
    np.testing.assert_allclose(losses(tmp_path), alone, rtol=2e-4)
    assert (tmp_path / "weights.safetensors").is_file()
