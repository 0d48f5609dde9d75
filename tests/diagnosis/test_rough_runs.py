"""Comparisons by simulators that are far off, of runs that are not alike."""

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from plants import recordings

from keycld_envs.effects import ActuatorGain
from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.following import followed
from keycld_model.diagnosis.discrepancy.inertias import with_own_masses


def friction(c: float):
    """Drag and dry friction, which the simulator lacks."""
    return lambda t, q, v, u: -0.01 * v * np.abs(v) - c * np.tanh(v / 0.01)


def lighter(factor: float) -> mujoco.MjModel:
    """The pendulum's simulator with masses and inertias off by a factor."""
    model = get_system("pendulum").compile()
    model.body_mass[1:] *= factor
    model.body_inertia[1:] *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


@pytest.fixture(scope="module")
def before() -> Sequence[Recording]:
    return recordings("pendulum", 3, friction(0.05), errors=0.0, number=8)[:5]


@pytest.mark.long
def test_a_simulator_that_is_far_too_light_gets_the_masses_of_the_recordings(before: Sequence[Recording]) -> None:
    right, light = get_system("pendulum").compile(), lighter(1 / 3)
    motion, *_ = followed(before, len(before), light, STANDARD)
    assert motion.model.dof_M0[0] == pytest.approx(right.dof_M0[0], rel=0.25)
    motion, *_ = followed(before, len(before), right, STANDARD)
    assert motion.model.dof_M0[0] == right.dof_M0[0]


def test_masses_that_fall_are_not_believed(before: Sequence[Recording]) -> None:
    motion, *_ = followed(before, len(before), get_system("pendulum").compile(), STANDARD)
    name = "mass of pole"
    heavier = with_own_masses(motion, {name: 0.9}, STANDARD, 0.5)
    assert heavier is not None and heavier.body_mass[1] == pytest.approx(1.9 * motion.model.body_mass[1])
    assert with_own_masses(motion, {name: -0.9}, STANDARD, 0.5) is None
    assert with_own_masses(motion, {name: 0.1}, STANDARD, 0.5) is None


@pytest.mark.long
def test_what_changed_is_sized_by_a_simulator_that_is_far_too_light(before: Sequence[Recording]) -> None:
    new = recordings("pendulum", 3, friction(0.15), errors=0.0, number=8)[5:]
    report = diagnose(new, lighter(1 / 3), baseline=before)
    assert [(f.effect, f.where["name"]) for f in report.findings] == [("coulomb_friction", "hinge")]
    assert report.findings[0].parameters["c"].value == pytest.approx(0.1, rel=0.2)


def test_unknown_forces_are_larger_in_rough_runs_but_not_because_something_changed() -> None:
    rng = np.random.default_rng(0)
    gusts = rng.normal(0, 0.3, 1000)

    def rough(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return friction(0.05)(t, q, v, u) + gusts[int(t / 0.05)]

    calm, wild = (recordings("pendulum", 3, force, errors=0.0, number=6) for force in (friction(0.05), rough))
    changed = recordings("pendulum", 3, friction(0.5), errors=0.0, number=6)
    runs = [calm[0], calm[1], wild[2], calm[3], changed[4]]
    motion, _, discrepancy = followed(runs, 4, get_system("pendulum").compile(), STANDARD)
    share = [float(discrepancy.share[motion.windows.recording == r][0]) for r in range(5)]
    assert share[2] > 2 * max(share[0], share[1], share[3])
    assert share[4] <= share[2]


def test_a_weak_motor_is_told_together_with_a_heavy_link_where_there_is_but_one() -> None:
    pendulum, acrobot = (get_system(name).compile() for name in ("pendulum", "acrobot"))
    motor = pendulum.actuator(0).name
    assert ActuatorGain(motor, k=0.5).indistinguishable(pendulum) == (("added_inertia", "body", "pole"),)
    assert not ActuatorGain(motor, k=1.5).indistinguishable(pendulum)
    assert not ActuatorGain(acrobot.actuator(0).name, k=0.5).indistinguishable(acrobot)
