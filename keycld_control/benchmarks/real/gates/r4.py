"""R4: a cup of coins on a string, tracked in the video of a phone."""

from collections.abc import Mapping
from functools import partial

import mujoco

from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, Gate, Outcome, RecordingFile
from keycld_control.benchmarks.real.rigs import RigidLink, pendulum
from keycld_envs.recordings.importers import Columns, read_csv

MASS, LENGTH = 0.0415, 0.65
"""kg, m; of the owner's report."""
TRIAL = RecordingFile(
    "string_pendulum_phone/lab1_data.txt",
    Columns("time", {"hinge": "angle"}),
    "trial 1",
    "MIT",
    "tylertian123/phy180_lab",
    partial(read_csv, names=["time", "angle", "residual"]),
)
"""116 s at 20 Hz. The third column is the owner's residual, which is left out."""


def simulator() -> mujoco.MjModel:
    """A mass point on a rigid, weightless string, no friction."""
    return pendulum(RigidLink(MASS, LENGTH, 1.0005 * MASS * LENGTH**2), motor=False)


def check(diagnoses: Mapping[str, Diagnosed]) -> Outcome:
    """Drag of the air is the only finding, and the phase error is not explained away."""
    diagnosed = diagnoses["diagnosis"]
    drag, unexplained = diagnosed.estimate("quadratic_drag", "d", "hinge"), diagnosed.report.unexplained
    return Outcome(
        f"{diagnosed.describe()}; {unexplained.message}",
        drag is not None and len(diagnosed.report.findings) == 1 and unexplained.significant,
        {
            "drag_per_inertia": None if drag is None else drag / (MASS * LENGTH**2),
            "errors_mrad": diagnosed.errors,
            "unexplained_fraction": unexplained.fraction,
            "diagnosis_s": diagnosed.seconds,
        },
    )


GATE = Gate(
    name="R4",
    title="string pendulum, phone video, 20 Hz",
    required="quadratic_drag and nothing else named; more than noise (a phase error) stays unexplained",
    simulator=simulator,
    data={"diagnosis": DataSplit([TRIAL])},
    check=check,
    tracked=True,
    plotted=10.0,
)
