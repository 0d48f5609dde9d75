"""What others would do with a sealed case."""

from dataclasses import replace

import numpy as np
import pytest

from keycld_control.benchmarks.blind.case import TRAINING, draw_case, recording
from keycld_control.benchmarks.blind.mechanisms.friction import Viscous
from keycld_control.benchmarks.blind.methods import get_method
from keycld_control.benchmarks.blind.plan import Plan
from keycld_control.benchmarks.blind.plant import CasePlant
from keycld_envs.systems import get_system

B, USED = 0.05, 5
"""Viscous friction, N m s, and number of training recordings."""


@pytest.fixture(scope="module")
def case():
    """A pendulum with viscous friction, good sensors, and steady clocks."""
    drawn, _ = draw_case(Plan("null", "pendulum", "open_loop"), (1, 2))
    quiet = replace(drawn, noise=np.array([2e-4]), rate=100.0, jitter=False, mechanisms=(Viscous(0, -1, B),))
    assert isinstance(quiet.plant, CasePlant)
    signals = quiet.simulate(range(TRAINING - USED, TRAINING + 2))
    assert signals is not None
    recordings = [recording(quiet, run, s) for run, s in enumerate(signals)]
    return recordings[:USED], recordings[USED:], get_system("pendulum").compile()


@pytest.mark.long
@pytest.mark.parametrize("name", ["refit", "greedy", "sindy", "neural"])
def test_what_each_says_of_viscous_friction(case, name):
    if name == "sindy":
        pytest.importorskip("pysindy")
    report = get_method(name)(*case)
    names = {f["effect"] for f in report["findings"]}
    errors = report["fit"]
    assert errors["nominal"] > errors["refitted"] > 1
    if name == "refit":
        assert (report["verdict"], names, errors["corrected"]) == ("undetermined", set(), errors["refitted"])
        assert report["unexplained"]["significant"]
        return
    assert errors["corrected"] < 0.5 * errors["refitted"]
    if name == "neural":
        assert names == set()
        return
    assert report["verdict"] == "mismatch" and "viscous_friction" in names
    (viscous,) = (f for f in report["findings"] if f["effect"] == "viscous_friction")
    (estimate,) = viscous["parameters"].values()
    assert abs(estimate["value"]) == pytest.approx(B, rel=0.02 if name == "greedy" else 0.2)
