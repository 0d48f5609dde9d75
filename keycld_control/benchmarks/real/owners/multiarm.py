"""The single pendulum of the multi-arm pendulum on a cart as its owners identified it."""

from pathlib import Path

from keycld_control.benchmarks.real.owners.model import OwnersModel
from keycld_control.benchmarks.real.simulators import Link, Pendulum
from keycld_envs.effects import ViscousFriction
from keycld_envs.errors import InputError
from keycld_envs.recordings.importers import read_mat

FILE = "multiarm_pendulum/ParameterEstimation/SinglePendulum/EstimatedParameters_SinglePendulum.mat"


def owners_models(folder: Path) -> list[OwnersModel]:
    """The one: mass, centre of mass, inertia about it, viscous friction and gravity; angle 180 degrees hangs.

    Raises:
        InputError: if the file is missing or damaged.
    """
    values = read_mat(folder / FILE).columns.get("EstimatedParameters", ())
    if len(values) != 5:
        raise InputError(f"{folder / FILE} has no five EstimatedParameters; get it anew, see docs/real-data.md.")
    mass, com, inertia, viscous, gravity = map(float, values)
    link = Link(mass, com, inertia + mass * com**2)
    simulator = Pendulum(link, turned=180.0, gravity=gravity).model(folder)
    return [OwnersModel("EstimatedParameters", simulator, (ViscousFriction("hinge", viscous),))]
