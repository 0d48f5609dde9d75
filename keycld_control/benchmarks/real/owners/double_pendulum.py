"""The double pendulum of the DFKI Underactuated Lab as identified for each of its designs."""

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from keycld_control.benchmarks.real.owners.model import OwnersModel
from keycld_control.benchmarks.real.parameter_files import numbers_of
from keycld_control.benchmarks.real.simulators import DoublePendulum, Link
from keycld_envs.effects import CoulombFriction, ViscousFriction

JOINTS = ("shoulder", "elbow")
MODELS = {"A.0": ("1.0", "2.0"), "C.0": ("h1.0", "3.0"), "C.1": ("1.0", "2.0", "3.0")}
"""Files with friction, of each design; others leave it out for controllers that compensate for it."""
NEEDED = ("m1", "m2", "r1", "r2", "I1", "I2", "l1", "Ir", "gr", "b1", "b2", "cf1", "cf2")


def owners_models(folder: Path, design: str) -> list[OwnersModel]:
    """All of a design. The owners' dry friction is cf atan(100 v), which is cf pi/2 beyond some hundredths of a rad/s.

    Raises:
        InputError: if a file is missing or damaged.
    """
    out = []
    for name in MODELS[design]:
        path = (
            "dfki_double_pendulum/data/system_identification/identified_parameters/"
            f"design_{design}/model_{name}/model_parameters.yml"
        )
        known, effects = numbers_of(folder / path, NEEDED), []
        for i, joint in enumerate(JOINTS, 1):
            effects += [ViscousFriction(joint, known[f"b{i}"]), CoulombFriction(joint, known[f"cf{i}"] * np.pi / 2)]
        out.append(OwnersModel(name, _simulator(known, folder), tuple(effects)))
    return out


def _simulator(known: Mapping[str, float], folder: Path) -> mujoco.MjModel:
    """Without friction.

    Where the second link has less inertia than its mass at a point, mass at the elbow goes from the first to the
    second: both move in the same way with it.
    """
    m1, m2, l1 = known["m1"], known["m2"], known["l1"]
    lever = m2 * known["r2"]
    more = max(0.0, 1.01 * lever**2 / known["I2"] - m2)
    rotor, gear = known["Ir"], known["gr"]
    upper = Link(m1, known["r1"] - more * l1 / m1, known["I1"] - more * l1**2, rotor, gear)
    lower = Link(m2 + more, lever / (m2 + more), known["I2"], rotor, gear)
    return DoublePendulum(upper, lower, l1).model(folder)
