"""R6: a pendulum with a motor that logs its torque."""

import time
from pathlib import Path

import mujoco
import numpy as np

from keycld_control.benchmarks.real.gate import GateResult, describe, find, locate, timed_diagnosis
from keycld_control.benchmarks.real.replay import curves
from keycld_control.benchmarks.real.rigs import Link, pendulum
from keycld_envs.recordings import Recording
from keycld_envs.recordings.importers import Columns, assemble, read_csv

FOLDER = "dfki_simple_pendulum/results"
TRAINING = "control_method_pd/system_identification"
HELD_OUT = ("control_method_direct_collocation", "control_method_ilqr", "control_method_energy_shaping")
PUBLISHED = {"J": 0.06259, "mc": 0.1022, "Fv": 0.04707, "Fc": 0.1839, "offset": -0.07586}
"""kg m², kg m, N m s, N m (times atan(100 v)), N m; system_identification.txt beside the data."""
LENGTH = 0.5
"""m, of the link."""
NEAR = 0.25
"""Relative deviation that still counts as near."""
REQUIRED = "viscous and Coulomb friction near Fv = 0.047, Fc = 0.184 × π/2 = 0.289, J = 0.0626, m c = 0.102"


def recording(folder: Path, run: str) -> Recording:
    """One run; the action is the torque that the motor reports."""
    table = read_csv(locate(folder, f"{FOLDER}/{run}/data_measured.csv"))
    columns = Columns("time", {"hinge": "position"}, {"hinge": "velocity"}, {"motor": "torque"})
    origin = "dfki-ric-underactuated-lab/torque_limited_simple_pendulum"
    return assemble(table, columns, run.removeprefix("control_method_"), licence="BSD-3-Clause", origin=origin)


def simulator() -> mujoco.MjModel:
    """J and m c as published, no friction, no offset."""
    return pendulum(Link(PUBLISHED["mc"] / LENGTH, LENGTH, PUBLISHED["J"]), motor=True)


def run(folder: Path) -> GateResult:
    """Run the gate."""
    start = time.perf_counter()
    training, held_out, model = [recording(folder, TRAINING)], [recording(folder, r) for r in HELD_OUT], simulator()
    report, seconds = timed_diagnosis(training, model, held_out)
    mass, length = (report.nuisance[f"{what} of link"].value for what in ("mass", "length"))
    reached = {"J": PUBLISHED["J"] * mass * length**2, "mc": PUBLISHED["mc"] * mass * length}
    required = {"J": PUBLISHED["J"], "mc": PUBLISHED["mc"], "Fv": PUBLISHED["Fv"], "c": PUBLISHED["Fc"] * np.pi / 2}
    for name, effect, parameter in (("Fv", "viscous_friction", "b"), ("c", "coulomb_friction", "c")):
        finding = find(report, effect, "hinge")
        reached[name] = np.nan if finding is None else finding.parameters[parameter].value
    near = {name: bool(abs(reached[name] / value - 1) < NEAR) for name, value in required.items()}
    return GateResult(
        gate="R6",
        title="pendulum with a motor",
        required=REQUIRED,
        reached=f"{describe(report)}; J = {reached['J']:.3g}, m c = {reached['mc']:.3g}",
        passed=all(near.values()),
        numbers={
            "reached": {name: round(value, 5) for name, value in reached.items()},
            "near": near,
            "errors_mrad": [report.fit.nominal, report.fit.refitted, report.fit.corrected],
            "diagnosis_s": seconds,
        },
        seconds=round(time.perf_counter() - start, 1),
        reports={"diagnosis": report},
        curves=curves(report, model, held_out, 2.0),
    )
