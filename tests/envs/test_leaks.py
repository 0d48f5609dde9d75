import gc
import os
from pathlib import Path

import pytest

from keycld_envs import KeyCLDEnv, System

STATM = Path("/proc/self/statm")
pytestmark = [
    pytest.mark.long,
    pytest.mark.render,
    pytest.mark.skipif(not STATM.exists(), reason="reads Linux's /proc"),
]


def resident_mib() -> float:
    gc.collect()
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def test_5000_resets_do_not_leak() -> None:
    env = KeyCLDEnv("pendulum", width=8, height=8)
    for _ in range(500):
        env.reset()
    before = resident_mib()
    for _ in range(5_000):
        env.reset()
    assert resident_mib() - before < 4
    env.close()


def test_100_open_and_close_cycles_do_not_leak(slider: System) -> None:
    def cycle() -> None:
        env = KeyCLDEnv(slider, width=8, height=8)
        env.reset(seed=0)
        env.close()

    for _ in range(20):
        cycle()
    before = resident_mib()
    for _ in range(100):
        cycle()
    assert resident_mib() - before < 4
