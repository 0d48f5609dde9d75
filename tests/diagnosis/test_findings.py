"""What fits mean."""

import pytest

from keycld_envs.effects import ActuatorDelay, Cogging, ExternalPeriodic, JointFlexibility, Spring, ViscousFriction
from keycld_envs.systems import get_system
from keycld_model.diagnosis.verdict.findings import RIGHT, calibrated, estimates
from keycld_model.diagnosis.verdict.report import Finding, Unexplained


@pytest.mark.parametrize(
    "effect, units",
    [
        (ViscousFriction("slider"), ["N s/m"]),
        (ViscousFriction("hinge_1"), ["N m s/rad"]),
        (Spring("slider"), ["N/m", "N"]),
        (ExternalPeriodic("slider"), ["N", "N", "rad/s"]),
        (Cogging("hinge_1"), ["N m", "N m", "1"]),
        (JointFlexibility("slide"), ["kg", "N/m", "1"]),
        (ActuatorDelay("slide"), ["s"]),
    ],
    ids=lambda x: x.id + x.where if hasattr(x, "id") else "",
)
def test_units_are_those_of_the_joint(effect, units):
    found = estimates(effect, [0.1] * len(units), get_system("cartpole").compile())
    assert [e.unit for e in found.values()] == units


def finding(effect: str) -> Finding:
    return Finding(effect, "force", {"kind": "joint", "name": "hinge"}, {}, "", 0.9, [])


@pytest.mark.parametrize(
    "effects, left, confidence",
    [
        (["spring"], False, [0.9 * RIGHT["explained"]]),
        (["external_pulse"], False, [0.9 * RIGHT["explained"]]),
        (["spring", "cogging"], True, [0.9 * RIGHT["left"]] * 2),
        (["spring", "unknown"], True, [0.9 * RIGHT["beside"], 0.9]),
        (["unknown"], True, [0.9]),
    ],
)
def test_confidence_counts_what_else_the_report_says(effects, left, confidence):
    out = calibrated([finding(e) for e in effects], Unexplained(left, 0.1, "hinge", ""))
    assert [f.confidence for f in out] == pytest.approx(confidence, abs=1e-4)
