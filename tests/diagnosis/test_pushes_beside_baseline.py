"""Pushes in one of the new recordings are found beside a baseline, and none where nobody pushes."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from test_comparison import sets

from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.bells import DURATIONS, standing
from keycld_model.diagnosis.discrepancy.pushes import Push, Pushes
from keycld_model.diagnosis.discrepancy.smoothed import STEP

AT, WIDE = 1.5, 0.09


def bell(t: float | np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * ((np.asarray(t) - AT) / WIDE) ** 2)


def push(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    return 0.6 * np.eye(len(v))[-1] * bell(t)


@pytest.mark.long
def test_a_push_in_one_run_is_found_with_its_time_and_size_and_nothing_else() -> None:
    (pushed, *_), before = sets("pendulum", push)
    quiet, _ = sets("pendulum", None)
    report = diagnose([pushed, *quiet[1:]], get_system("pendulum").compile(), baseline=before)
    (finding,) = report.findings
    assert (report.verdict, finding.effect, finding.where["name"]) == ("mismatch", "external_pulse", "hinge")
    assert finding.when_by_recording is not None and list(finding.when_by_recording) == [pushed.id]
    ((start, end),) = finding.when_by_recording[pushed.id]
    assert start == pytest.approx(AT - 2 * WIDE, abs=0.1) and end == pytest.approx(AT + 2 * WIDE, abs=0.1)
    assert finding.parameters["f"].value == pytest.approx(0.6, rel=0.25)


@pytest.mark.long
def test_where_nobody_pushes_and_where_a_friction_is_new_no_push_is_found() -> None:
    model = get_system("pendulum").compile()
    quiet, before = sets("pendulum", None)
    assert diagnose(quiet, model, baseline=before).findings == []

    def friction(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return -0.08 * np.eye(len(v))[-1] * v

    found = diagnose(sets("pendulum", friction)[0], model, baseline=before).findings
    assert [f.effect for f in found] == ["viscous_friction"]


def test_a_bell_stands_out_at_its_time_by_its_height_over_what_is_usual_unless_nothing_is_known_there() -> None:
    rng, t = np.random.default_rng(5), STEP * np.arange(400, dtype=np.float64)
    left = 0.01 * rng.standard_normal((len(t), 2)) + np.outer(bell(t), [0.3, 0.0])
    spread, known = np.full_like(left, 0.05), np.ones(len(t), dtype=np.bool_)
    stands = standing(left, spread, known)
    d, k, joint = np.unravel_index(np.argmax(np.abs(stands.gain)), stands.gain.shape)
    assert (DURATIONS[d], joint) == (4 * WIDE, 0)
    assert t[k] == pytest.approx(AT, abs=0.02)
    assert stands.height[d, k, joint] == pytest.approx(0.3, abs=0.02)
    assert stands.most[d, 0] > 5 * stands.most[d, 1]
    hidden = standing(left, spread, np.abs(t - AT) > 0.3)
    assert hidden.most[:, 0].max() < 0.2 * stands.most[:, 0].max()


@pytest.mark.parametrize("period, comes_back", [(1.2, True), (100.0, False)])
def test_a_force_that_comes_back_in_the_same_states_is_no_push(period: float, comes_back: bool) -> None:
    time = STEP * (np.arange(600) + 0.5)
    states = np.stack([np.cos(2 * np.pi * time / 1.2), np.sin(2 * np.pi * time / 1.2)], axis=-1)
    left = np.exp(-0.5 * (((time - AT + period / 2) % period - period / 2) / WIDE) ** 2)[:, None]
    inside = np.ones((1, len(time)), dtype=np.bool_)
    motion = SimpleNamespace(time=time[None], inside=inside)
    pushes = SimpleNamespace(motion=motion, new=(0,), criteria=STANDARD, _states=lambda: states[None])
    stands: Any = {0: SimpleNamespace(left=left)}
    push = Push(0, 0, AT - 2 * WIDE, 4 * WIDE, 1.0, 0.1, 3.0)
    assert Pushes._elsewhere(cast("Pushes", pushes), push, stands) is comes_back
