"""Links that ring: velocities beside the path that a simulator can follow, and what friction makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from plants import NOISE, SAMPLE, recordings

from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.motion import Motion

SIZE, FREQUENCY = 0.012, 2 * np.pi * 12
"""Of a vibration, rad and rad/s."""


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    return recordings("pendulum", 5, errors=0.0, number=2)


def followed(runs: list[Recording]) -> Motion:
    return Motion.of(runs, get_system("pendulum").compile(), STANDARD)


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def test_velocities_have_the_vibrations_that_encoders_show(runs: list[Recording]) -> None:
    ring = [SIZE * np.sin(FREQUENCY * np.asarray(r.t_state))[:, None] for r in runs]
    shaken = [replace(r, qpos=np.asarray(r.qpos) + x) for r, x in zip(runs, ring, strict=True)]
    calm, motion = followed(runs), followed(shaken)
    zero = np.array([np.asarray(r.t_state)[0] for r in runs])[motion.windows.recording]
    rate = SIZE * FREQUENCY * np.cos(FREQUENCY * (motion.time + zero[:, None]))
    truth = calm.v + rate[..., None]
    assert rms(motion.vibrating - truth) < 0.35 * rms(motion.v - truth)


def test_noise_is_no_vibration(runs: list[Recording]) -> None:
    motion = followed(runs)
    assert rms(motion.vibrating - motion.v) < 0.05 * np.sqrt(2) * NOISE / SAMPLE
    gap = [
        replace(r, qpos=np.where(np.arange(len(np.asarray(r.qpos)))[:, None] % 7, np.asarray(r.qpos), np.nan))
        for r in runs
    ]
    assert np.isfinite(followed(gap).vibrating).all()
