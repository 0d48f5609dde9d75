"""R2: the friction of a double pendulum, which its controller compensates."""

from collections.abc import Mapping

import numpy as np

from keycld_control.benchmarks.real import dfki
from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, Gate, Outcome

TRAINING = (
    "pendubot/real_hardware_v2/src_data/sac_lqr/experiment01",
    "pendubot/real_hardware_v2/src_data/sac_lqr/experiment02",
)
FRICTION = {"shoulder": 0.16 * np.pi / 2, "elbow": 0.12 * np.pi / 2}
"""N m: what the controller compensates with 0.16 and 0.12 × atan(100 v)."""
NEAR = 0.1
"""Relative deviation that is allowed."""


def check(diagnoses: Mapping[str, Diagnosed]) -> Outcome:
    """The friction is as large as its compensation; the viscous 0.001 N m s must not be called identifiable."""
    diagnosed = diagnoses["diagnosis"]
    found = {joint: diagnosed.estimate("coulomb_friction", "c", joint) for joint in FRICTION}
    near = all(c is not None and abs(c / FRICTION[joint] - 1) <= NEAR for joint, c in found.items())
    return Outcome(
        diagnosed.describe(),
        near and diagnosed.find("viscous_friction") is None,
        {
            "coulomb_Nm": found,
            "required_Nm": FRICTION,
            "errors_mrad": diagnosed.errors,
            "diagnosis_s": diagnosed.seconds,
        },
    )


GATE = Gate(
    name="R2",
    title="double pendulum, hidden friction",
    required="coulomb_friction at both joints, 0.251 and 0.188 N m within 10 %; no viscous friction claimed",
    simulator=dfki.simulator,
    data={
        "diagnosis": DataSplit(
            [dfki.run_file(run, run.split("/")[-1], "tau_meas") for run in TRAINING],
            [dfki.run_file(dfki.ILQR_TVLQR_LQR, "acrobot", "tau_meas")],
        )
    },
    check=check,
    plotted=2.0,
)
"""The known input is the torque that the motors report; the simulator has no friction."""
