"""Positions read off images of a camera that looks askew, and whose shutter rolls."""

from dataclasses import replace

import numpy as np
import pytest
from plants import recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose


def filmed(runs, squash: float, skew: float, shutter: float):
    """The same recordings as a camera sees them."""
    out = []
    for run in runs:
        q, t = np.asarray(run.qpos), np.asarray(run.t_state)
        speed = np.gradient(q, t, axis=0)
        seen = q + squash * np.sin(2 * q) + skew * (np.cos(2 * q) - 1) + shutter * speed * np.sin(q)
        out.append(replace(run, qpos=seen))
    return out


@pytest.mark.long
def test_errors_of_a_camera_are_no_missing_physics():
    runs = filmed(recordings("pendulum", 3, number=4, seconds=2.0), 0.03, -0.02, 0.008)
    model = get_system("pendulum").compile()
    report = diagnose(runs, model, tracked=True)
    assert report.verdict == "no_mismatch"
    errors = {name: report.nuisance[f"{name} of hinge"] for name in ("squash", "skew", "shutter")}
    assert [e.value for e in errors.values()] == pytest.approx([0.03, -0.02, 0.008], abs=0.003)
    assert [e.unit for e in errors.values()] == ["rad", "rad", "s"]
    assert diagnose(runs, model).verdict != "no_mismatch"
