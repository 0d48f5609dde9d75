"""Physics that comes and goes, and physics without a name."""

import numpy as np
import pytest
from plants import recordings

from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose


def push(t, q, v, u):
    """Half a newton metre twice in every run, in either direction."""
    return np.array([0.5 * (0.9 <= t < 1.1) - 0.5 * (2.1 <= t < 2.3)])


@pytest.mark.long
def test_pushes_are_found_and_timed():
    report = diagnose(recordings("pendulum", seed=5, force=push), get_system("pendulum").compile())
    assert report.verdict == "mismatch"
    (finding,) = report.findings
    assert (finding.effect, finding.where["name"]) == ("external_pulse", "hinge")
    assert finding.when_by_recording
    found = [span for spans in finding.when_by_recording.values() for span in spans]
    true = [(0.9, 1.1), (2.1, 2.3)]
    for a, b in found:
        assert max(min(b, d) - max(a, c) for c, d in true) > 0  # no alarm outside
    for spans in finding.when_by_recording.values():
        for c, d in true:
            shared = sum(max(0.0, min(b, d) - max(a, c)) for a, b in spans)
            union = d - c + sum(b - a for a, b in spans if min(b, d) > max(a, c)) - shared
            assert shared / union > 0.6
    assert report.fit.corrected < 0.2 * report.fit.refitted


def wind(t, q, v, u):
    """Drag against air that moves sideways."""
    relative = 2 * np.cos(q) - v
    return 0.03 * relative * np.abs(relative)


@pytest.mark.long
def test_what_has_no_name_is_called_unknown_and_mended():
    report = diagnose(recordings("pendulum", seed=6, force=wind), get_system("pendulum").compile())
    assert (report.verdict, [f.effect for f in report.findings]) == ("mismatch", ["unknown"])
    assert report.fit.corrected < 0.2 * report.fit.refitted
    assert report.fit.corrected == pytest.approx(1.0, abs=0.5)  # mrad, the sensor's noise


def efficiency(t, q, v, u):
    """A motor that is stronger at some positions."""
    return 2 * u * 0.4 * np.sin(2 * q)


@pytest.mark.long
def test_a_motor_that_depends_on_positions_is_mended():
    report = diagnose(recordings("pendulum", seed=7, force=efficiency), get_system("pendulum").compile())
    assert "unknown" in [f.effect for f in report.findings] or report.unexplained.significant
    assert report.fit.refitted is not None and report.fit.corrected < 0.5 * report.fit.refitted
