"""What fits mean."""

import pytest

from keycld_envs.effects import ActuatorDelay, Cogging, ExternalPeriodic, JointFlexibility, Spring, ViscousFriction
from keycld_envs.systems import get_system
from keycld_model.diagnosis.findings import _estimates


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
    estimates = _estimates(effect, iter([0.1] * 3), get_system("cartpole").compile())
    assert [e.unit for e in estimates.values()] == units
