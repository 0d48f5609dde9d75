"""A diagnosis with a budget of seconds: the best so far, and what was not tried."""

import time
from typing import Any

import numpy as np
import pytest
from plants import recordings

from keycld_envs.errors import InputError
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.search.budget import Budget, OutOfTime


def friction(_t: float, _q: np.ndarray, v: np.ndarray, _u: np.ndarray) -> np.ndarray:
    return -0.1 * v


@pytest.mark.slow
def test_the_best_so_far_is_reported_with_what_was_not_tried() -> None:
    runs, model = recordings("pendulum", 2, friction, number=6, seconds=1.5), get_system("pendulum").compile()
    report = diagnose(runs, model, budget=1e-3)
    assert report.details["not_tried"] == [
        "sets of effects after the first 1",
        "the other integrator",
        "a residual force",
    ]
    assert report.verdict == "undetermined" and not report.findings and report.unexplained.significant


def test_a_search_ends_once() -> None:
    budget = Budget(0.01)
    budget.check(1)
    time.sleep(0.02)
    with pytest.raises(OutOfTime):
        budget.check(2)
    budget.check(3)
    assert budget.leaves_out("rivals") and budget.not_tried == ["sets of effects after the first 2", "rivals"]
    assert not Budget(None).leaves_out("rivals")


@pytest.mark.parametrize("seconds", [0, -1, float("nan"), float("inf"), "60", True])
def test_what_is_no_budget(seconds: Any) -> None:
    with pytest.raises(InputError, match="budget must be a positive number of seconds"):
        Budget(seconds)
