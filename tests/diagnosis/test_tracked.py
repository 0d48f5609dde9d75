"""Positions read off images of a camera that looks askew, and whose shutter rolls."""

from dataclasses import replace

import numpy as np
import pytest
from plants import recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regressors import shared_terms
from keycld_model.diagnosis.inputs.observation import JointPositions


def filmed(runs, squash: float, skew: float, shutter: float):
    """The same recordings as a camera sees them."""
    out = []
    for run in runs:
        q, t = np.asarray(run.qpos), np.asarray(run.t_state)
        speed = np.gradient(q, t, axis=0)
        seen = q + squash * np.sin(2 * q) + skew * (np.cos(2 * q) - 1) + shutter * speed * np.sin(q)
        out.append(replace(run, qpos=seen))
    return out


def left_by_what_all_recordings_share(motion):
    """Mean square of whitened residuals, and the size of each term."""
    terms = shared_terms(motion, STANDARD)
    white = np.stack([*(term.column for term in terms), motion.residual], axis=-1)
    basis = np.linalg.qr(motion.states)[0]
    rows = (white - basis @ (np.swapaxes(basis, 1, 2) @ white)).reshape(-1, len(terms) + 1)
    columns, target = rows[:, :-1], rows[:, -1]
    prior = np.diag([1e-9 + 1 / term.spread**2 for term in terms])
    sizes = np.linalg.solve(columns.T @ columns + prior, columns.T @ target)
    return np.mean((target - columns @ sizes) ** 2), dict(zip([term.name for term in terms], sizes, strict=True))


def test_errors_of_a_camera_are_among_what_recordings_share():
    model = get_system("pendulum").compile()
    runs = filmed(recordings("pendulum", 3, number=3, seconds=2.0), 0.03, -0.02, 0.008)
    left, sizes = left_by_what_all_recordings_share(
        Motion.of(runs, model, STANDARD, JointPositions(model, tracked=True))
    )
    assert left < 1.0  # the noise, but for what is fitted
    found = [sizes[f"{kind} of hinge"] for kind in ("squash", "skew", "shutter")]
    np.testing.assert_allclose(found, [0.03, -0.02, 0.008], atol=0.012)
    by_encoders, sizes = left_by_what_all_recordings_share(Motion.of(runs, model, STANDARD))
    assert by_encoders > 1.5 and "squash of hinge" not in sizes


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
