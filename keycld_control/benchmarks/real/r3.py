"""R3: the free swing of a single pendulum at 1 kHz, whose dissipation is more than one thing."""

import time
from pathlib import Path

import mujoco
import numpy as np

from keycld_control.benchmarks.real.gate import GateResult, describe, locate, timed_diagnosis
from keycld_control.benchmarks.real.replay import curves, refit, roll, simulator_of, variant
from keycld_control.benchmarks.real.rigs import Link, pendulum
from keycld_envs.effects import ViscousFriction
from keycld_envs.recordings import Recording
from keycld_envs.recordings.importers import Columns, assemble, read_mat

FILE = "multiarm_pendulum/ParameterEstimation/SinglePendulum/SinglePendulumDataForParameterEstimation.mat"
SECONDS = 9.17
"""Every segment is one rollout."""
REQUIRED = "two dissipation terms; held-out rollout error at most 1/3 of viscous-only (6.5 and 16.3 mrad)"
"""Of docs/real-data.md."""


def recordings(folder: Path) -> tuple[list[Recording], list[Recording]]:
    """Four segments of a decaying swing to learn from, and the two after them, as their owners cut them."""
    table = read_mat(locate(folder, FILE))

    def segment(part: str, i: int) -> Recording:
        columns = Columns(f"Time_{part}{{{i}}}", {"hinge": f"Y_{part}{{{i}}}[0]"})
        return assemble(table, columns, f"{part} {i}", licence="MIT", origin=f"dynamicslab/MultiArm-Pendulum: {FILE}")

    return [segment("id", i) for i in range(4)], [segment("vad", i) for i in range(2)]


def simulator() -> mujoco.MjModel:
    """Without friction; angle 180° hangs.

    EstimatedParameters_SinglePendulum.mat has 0.147755 kg, its centre of mass 0.147585 m from the joint, an inertia
    of 1.09119e-4 kg m² about it, a viscous friction of 2.2394e-4 N m s, and 9.81001 m/s².
    """
    mass, com = 0.147754901, 0.147584572
    return pendulum(Link(mass, com, 1.09118505e-4 + mass * com**2), motor=False, turned=180.0, gravity=9.81001310)


def run(folder: Path) -> GateResult:
    """Run the gate."""
    start = time.perf_counter()
    training, held_out = recordings(folder)
    model = simulator()
    report, seconds = timed_diagnosis(training, model, held_out)
    sim = simulator_of(report, model)
    viscous = roll(sim, refit(sim, (ViscousFriction("hinge", 1e-4),), training, SECONDS), held_out, SECONDS)
    found = roll(sim, variant(report, sim, findings=True), held_out, SECONDS)
    errors = {
        name: [round(r.error(i), 2) for i in range(len(held_out))]
        for name, r in {"viscous_only": viscous, "found": found}.items()
    }
    ratio = found.error() / viscous.error()
    terms = [f.effect for f in report.findings if f.family == "dissipation"]
    return GateResult(
        gate="R3",
        title="single pendulum, free swing, 1 kHz",
        required=REQUIRED,
        reached=f"{describe(report)}; {errors['found']} mrad, viscous-only {errors['viscous_only']}, ratio {ratio:.2f}",
        passed=bool(len(terms) >= 2 and ratio <= 1 / 3 and np.isfinite(ratio)),
        numbers={"errors_mrad": errors, "ratio": round(ratio, 3), "diagnosis_s": seconds},
        seconds=round(time.perf_counter() - start, 1),
        reports={"diagnosis": report},
        curves=curves(report, model, held_out, SECONDS),
    )
