"""The double pendulum of the DFKI Underactuated Lab as identified for each of its designs."""

from pathlib import Path

import numpy as np

from keycld_control.benchmarks.real import dfki
from keycld_control.benchmarks.real.owners.model import OwnersModel
from keycld_envs.effects import CoulombFriction, ViscousFriction

MODELS = {"A.0": ("1.0", "2.0"), "C.0": ("h1.0", "3.0"), "C.1": ("1.0", "2.0", "3.0")}
"""Files with friction, of each design; others leave it out for controllers that compensate for it."""


def owners_models(folder: Path, design: str) -> list[OwnersModel]:
    """All of a design. The owners' dry friction is cf atan(100 v), which is cf pi/2 beyond some hundredths of a rad/s.

    Raises:
        InputError: if a file is missing or damaged.
    """
    out = []
    for name in MODELS[design]:
        known, effects = dfki.parameters(folder, design, name), []
        for i, joint in enumerate(dfki.JOINTS, 1):
            effects += [ViscousFriction(joint, known[f"b{i}"]), CoulombFriction(joint, known[f"cf{i}"] * np.pi / 2)]
        out.append(OwnersModel(name, dfki.identified(design, name)(folder), tuple(effects)))
    return out
