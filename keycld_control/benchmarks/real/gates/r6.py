"""R6: a pendulum with a motor that logs its torque."""

from collections.abc import Mapping

import mujoco
import numpy as np

from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, Gate, Outcome, RecordingFile
from keycld_control.benchmarks.real.rigs import RigidLink, pendulum
from keycld_envs.recordings.importers import Columns

TRAINING = "control_method_pd/system_identification"
HELD_OUT = ("control_method_direct_collocation", "control_method_ilqr", "control_method_energy_shaping")
PUBLISHED = {"J": 0.06259, "mc": 0.1022, "Fv": 0.04707, "Fc": 0.1839, "offset": -0.07586}
"""kg m², kg m, N m s, N m (times atan(100 v)), N m; system_identification.txt beside the data."""
LENGTH = 0.5
"""m, of the link."""
NEAR = 0.25
"""Relative deviation that still counts as near."""


def run_file(run: str) -> RecordingFile:
    """One run; the action is the torque that the motor reports."""
    return RecordingFile(
        f"dfki_simple_pendulum/results/{run}/data_measured.csv",
        Columns("time", {"hinge": "position"}, {"hinge": "velocity"}, {"motor": "torque"}, units={"position": "rad"}),
        run.removeprefix("control_method_"),
        "BSD-3-Clause",
        "dfki-ric-underactuated-lab/torque_limited_simple_pendulum",
    )


def simulator() -> mujoco.MjModel:
    """J and m c as published, no friction, no offset."""
    return pendulum(RigidLink(PUBLISHED["mc"] / LENGTH, LENGTH, PUBLISHED["J"]), motor=True)


def check(diagnoses: Mapping[str, Diagnosed]) -> Outcome:
    """Inertia, mass times length, and friction come near what the owners identified."""
    diagnosed = diagnoses["diagnosis"]
    mass, length = (diagnosed.report.nuisance[f"{what} of link"].value for what in ("mass", "length"))
    viscous = diagnosed.estimate("viscous_friction", "b", "hinge")
    coulomb = diagnosed.estimate("coulomb_friction", "c", "hinge")
    reached = {
        "J": PUBLISHED["J"] * mass * length**2,
        "mc": PUBLISHED["mc"] * mass * length,
        "Fv": np.nan if viscous is None else viscous,
        "c": np.nan if coulomb is None else coulomb,
    }
    required = {"J": PUBLISHED["J"], "mc": PUBLISHED["mc"], "Fv": PUBLISHED["Fv"], "c": PUBLISHED["Fc"] * np.pi / 2}
    near = {name: bool(abs(reached[name] / value - 1) < NEAR) for name, value in required.items()}
    return Outcome(
        f"{diagnosed.describe()}; J = {reached['J']:.3g}, m c = {reached['mc']:.3g}",
        all(near.values()),
        {
            "reached": {name: round(value, 5) for name, value in reached.items()},
            "near": near,
            "errors_mrad": diagnosed.errors,
            "diagnosis_s": diagnosed.seconds,
        },
    )


GATE = Gate(
    name="R6",
    title="pendulum with a motor",
    required="viscous and Coulomb friction near Fv = 0.047, Fc = 0.184 × π/2 = 0.289, J = 0.0626, m c = 0.102",
    simulator=simulator,
    data={"diagnosis": DataSplit([run_file(TRAINING)], [run_file(run) for run in HELD_OUT])},
    check=check,
    plotted=2.0,
)
