"""R4: a cup of coins on a string, tracked in the video of a phone."""

import time
from pathlib import Path

import mujoco

from keycld_control.benchmarks.real.gate import GateResult, describe, find, locate, timed_diagnosis
from keycld_control.benchmarks.real.replay import curves
from keycld_control.benchmarks.real.rigs import Link, pendulum
from keycld_envs.recordings import Recording
from keycld_envs.recordings.importers import Columns, assemble, read_csv
from keycld_model.diagnosis.inputs.prepare import split

FILE = "string_pendulum_phone/lab1_data.txt"
MASS, LENGTH = 0.0415, 0.65
"""kg, m; of the owner's report."""
REQUIRED = "quadratic_drag and nothing else named; more than noise (a phase error) stays unexplained"


def recording(folder: Path) -> Recording:
    """The first trial: 116 s at 20 Hz. The third column is the owner's residual, which is left out."""
    table = read_csv(locate(folder, FILE), ["time", "angle", "residual"])
    return assemble(
        table, Columns("time", {"hinge": "angle"}), "trial 1", licence="MIT", origin="tylertian123/phy180_lab"
    )


def simulator() -> mujoco.MjModel:
    """A mass point on a rigid, weightless string, no friction."""
    return pendulum(Link(MASS, LENGTH, 1.0005 * MASS * LENGTH**2), motor=False)


def run(folder: Path) -> GateResult:
    """Run the gate; the last third is held out."""
    start = time.perf_counter()
    whole, model = recording(folder), simulator()
    report, seconds = timed_diagnosis([whole], model, tracked=True)
    drag = find(report, "quadratic_drag", "hinge")
    return GateResult(
        gate="R4",
        title="string pendulum, phone video, 20 Hz",
        required=REQUIRED,
        reached=f"{describe(report)}; {report.unexplained.message}",
        passed=drag is not None and len(report.findings) == 1 and report.unexplained.significant,
        numbers={
            "drag_per_inertia": None if drag is None else drag.parameters["d"].value / (MASS * LENGTH**2),
            "errors_mrad": [report.fit.nominal, report.fit.refitted, report.fit.corrected],
            "unexplained_fraction": report.unexplained.fraction,
            "diagnosis_s": seconds,
        },
        seconds=round(time.perf_counter() - start, 1),
        reports={"diagnosis": report},
        curves=curves(report, model, split([whole])[1], 10.0),
    )
