"""What recordings lack of a simulator whose misfit is far above noise."""

from dataclasses import replace

import numpy as np
import pytest
from plants import recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD

SIZES = np.array([0.15, 0.08])


def dry_beside_what_is_in_no_library(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    return -SIZES * np.tanh(v / 0.02) + 0.08 * np.sin(7 * np.sin(3 * t + q) + 5 * q[::-1] * v)


@pytest.mark.long
def test_dry_friction_at_both_joints_beside_much_that_nothing_explains() -> None:
    runs = recordings("acrobot", 3, dry_beside_what_is_in_no_library)
    asked = replace(STANDARD, far_above_noise=1.0)  # sensors of these runs are too coarse for the usual question
    report = diagnose(runs, get_system("acrobot").compile(), criteria=asked)
    assert report.verdict == "mismatch" and report.details["folds"] == len(runs)
    assert [f.where["name"] for f in report.findings] == ["shoulder", "elbow"]
    assert {f.effect for f in report.findings} == {"coulomb_friction"}
    for finding, size in zip(report.findings, SIZES, strict=True):
        assert finding.parameters["c"].value == pytest.approx(size, rel=0.3)
    assert report.fit.corrected < 0.7 * report.fit.refitted
