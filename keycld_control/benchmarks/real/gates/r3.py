"""R3: the free swing of a single pendulum at 1 kHz, whose dissipation is more than one thing."""

from collections.abc import Mapping

import mujoco
import numpy as np

from keycld_control.benchmarks.real.gate import DataSplit, Diagnosed, Gate, Outcome, RecordingFile
from keycld_control.benchmarks.real.replay import Rig, refit, roll, variant
from keycld_control.benchmarks.real.rigs import RigidLink, pendulum
from keycld_envs.effects import ViscousFriction
from keycld_envs.recordings.importers import Columns, read_mat

FILE = "multiarm_pendulum/ParameterEstimation/SinglePendulum/SinglePendulumDataForParameterEstimation.mat"
SECONDS = 9.17
"""Every segment is one rollout."""


def segment(part: str, i: int) -> RecordingFile:
    """A segment of a decaying swing, as its owners cut it: `part` "id" for identification, "vad" for validation."""
    columns = Columns(f"Time_{part}{{{i}}}", {"hinge": f"Y_{part}{{{i}}}[0]"})
    return RecordingFile(FILE, columns, f"{part} {i}", "MIT", f"dynamicslab/MultiArm-Pendulum: {FILE}", read_mat)


def simulator() -> mujoco.MjModel:
    """Without friction; angle 180° hangs.

    EstimatedParameters_SinglePendulum.mat has 0.147755 kg, its centre of mass 0.147585 m from the joint, an inertia
    of 1.09119e-4 kg m² about it, a viscous friction of 2.2394e-4 N m s, and 9.81001 m/s².
    """
    mass, com = 0.147754901, 0.147584572
    link = RigidLink(mass, com, 1.09118505e-4 + mass * com**2)
    return pendulum(link, motor=False, turned=180.0, gravity=9.81001310)


def check(diagnoses: Mapping[str, Diagnosed]) -> Outcome:
    """The findings leave at most a third of the held-out error that viscous friction alone leaves."""
    diagnosed = diagnoses["diagnosis"]
    report, training, held_out = diagnosed.report, diagnosed.training, diagnosed.held_out
    rig = Rig.of(report, diagnosed.model)
    opponent = refit(rig, (ViscousFriction("hinge", 1e-4),), training, SECONDS)
    viscous = roll(rig, opponent, held_out, SECONDS)
    found = roll(rig, variant(report, rig, findings=True), held_out, SECONDS)
    errors = {
        name: [round(rollouts.error(i), 2) for i in range(len(held_out))]
        for name, rollouts in {"viscous_only": viscous, "found": found}.items()
    }
    ratio = found.error() / viscous.error()
    terms = [f.effect for f in report.findings if f.family == "dissipation"]
    return Outcome(
        f"{diagnosed.describe()}; {errors['found']} mrad, viscous-only {errors['viscous_only']}, ratio {ratio:.2f}",
        bool(len(terms) >= 2 and ratio <= 1 / 3 and np.isfinite(ratio)),
        {"errors_mrad": errors, "ratio": round(ratio, 3), "diagnosis_s": diagnosed.seconds},
    )


GATE = Gate(
    name="R3",
    title="single pendulum, free swing, 1 kHz",
    required="two dissipation terms; held-out rollout error at most 1/3 of viscous-only (6.5 and 16.3 mrad)",
    simulator=simulator,
    data={"diagnosis": DataSplit([segment("id", i) for i in range(4)], [segment("vad", i) for i in range(2)])},
    check=check,
    plotted=SECONDS,
)
"""Four segments to learn from, and the two after them."""
