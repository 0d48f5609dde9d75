"""The simple pendulum of the DFKI Underactuated Lab as its owners identified it."""

from pathlib import Path

import numpy as np

from keycld_control.benchmarks.real.owners.model import OwnersModel
from keycld_control.benchmarks.real.parameter_files import numbers_of
from keycld_control.benchmarks.real.simulators import Link, Pendulum
from keycld_envs.effects import ConstantForce, CoulombFriction, ViscousFriction

FILE = "dfki_simple_pendulum/results/control_method_pd/system_identification/system_identification.txt"
LENGTH = 0.5
"""m, of the link."""


def owners_models(folder: Path) -> list[OwnersModel]:
    """The one: tau = J a + m c g sin q + Fv v + Fc atan(100 v) + offset.

    Raises:
        InputError: if the file is missing or damaged.
    """
    known = numbers_of(folder / FILE, ("J", "m*cx", "Fv", "Fc", "offset"))
    simulator = Pendulum(Link(known["m*cx"] / LENGTH, LENGTH, known["J"]), motor=True).model(folder)
    friction = ViscousFriction("hinge", known["Fv"]), CoulombFriction("hinge", known["Fc"] * np.pi / 2)
    return [OwnersModel("system_identification", simulator, (*friction, ConstantForce("hinge", -known["offset"])))]
