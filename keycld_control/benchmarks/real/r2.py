"""R2: the friction of a double pendulum, which its controller compensates."""

import time
from pathlib import Path

import numpy as np

from keycld_control.benchmarks.real import dfki
from keycld_control.benchmarks.real.gate import GateResult, describe, find, timed_diagnosis
from keycld_control.benchmarks.real.replay import curves

TRAINING = (
    "pendubot/real_hardware_v2/src_data/sac_lqr/experiment01",
    "pendubot/real_hardware_v2/src_data/sac_lqr/experiment02",
)
HELD_OUT = "acrobot/real_hardware_v2/src_data/ilqr_tvlqr_lqr/experiment01"
FRICTION = {"shoulder": 0.16 * np.pi / 2, "elbow": 0.12 * np.pi / 2}
"""N m: what the controller compensates with 0.16 and 0.12 × atan(100 v)."""
NEAR = 0.1
REQUIRED = "coulomb_friction at both joints, 0.251 and 0.188 N m within 10 %; no viscous friction claimed"
"""The viscous 0.001 N m s must not be called identifiable."""


def run(folder: Path) -> GateResult:
    """Run the gate: the known input is the torque that the motors report, the simulator has no friction."""
    start = time.perf_counter()
    model = dfki.simulator()
    training = [dfki.recording(dfki.table(folder, run), run.split("/")[-1], "tau_meas") for run in TRAINING]
    held_out = [dfki.recording(dfki.table(folder, HELD_OUT), "acrobot", "tau_meas")]
    report, seconds = timed_diagnosis(training, model, held_out)
    found = {joint: find(report, "coulomb_friction", joint) for joint in FRICTION}
    values = {joint: None if f is None else f.parameters["c"].value for joint, f in found.items()}
    near = all(v is not None and abs(v / FRICTION[joint] - 1) <= NEAR for joint, v in values.items())
    return GateResult(
        gate="R2",
        title="double pendulum, hidden friction",
        required=REQUIRED,
        reached=describe(report),
        passed=near and find(report, "viscous_friction") is None,
        numbers={
            "coulomb_Nm": values,
            "required_Nm": FRICTION,
            "errors_mrad": [report.fit.nominal, report.fit.refitted, report.fit.corrected],
            "diagnosis_s": seconds,
        },
        seconds=round(time.perf_counter() - start, 1),
        reports={"diagnosis": report},
        curves=curves(report, model, held_out, 2.0),
    )
