"""What recordings lack of a simulator whose misfit is far above noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from plants import recordings

from keycld_envs.effects import CoulombFriction, Effect, ViscousFriction
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.missing import Group, _folds
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.one_set import _rivals, _told
from keycld_model.diagnosis.search.hypotheses import Hypothesis
from keycld_model.diagnosis.verdict.report import Estimate, Finding

SIZES = np.array([0.15, 0.08])


def dry_beside_what_is_in_no_library(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    return -SIZES * np.tanh(v / 0.02) + 0.08 * np.sin(7 * np.sin(3 * t + q) + 5 * q[::-1] * v)


@pytest.mark.long
def test_dry_friction_at_both_joints_beside_much_that_nothing_explains() -> None:
    runs = recordings("acrobot", 3, dry_beside_what_is_in_no_library)
    asked = replace(STANDARD, far_above_noise=1.0)  # sensors of these runs are too coarse for the usual question
    report = diagnose(runs, get_system("acrobot").compile(), criteria=asked)
    assert report.verdict == "mismatch" and report.details["folds"] == len(runs)
    assert [f.where["name"] for f in report.findings] == ["shoulder", "elbow"]
    assert {f.effect for f in report.findings} == {"coulomb_friction"}
    for finding, size in zip(report.findings, SIZES, strict=True):
        assert finding.parameters["c"].value == pytest.approx(size, rel=0.3)
    assert report.fit.corrected < 0.7 * report.fit.refitted


def test_parts_of_a_recording_have_as_much_motion_each() -> None:
    """A mechanism that is swung up and then held is no witness while it is held: folds without motion tell nothing."""
    swing, held = np.tile([0.0, 1.0, 0.0, 1.0], (6, 1))[..., None], np.zeros((6, 4, 1))
    recording = np.repeat([0, 1, 2], 12)
    motion = SimpleNamespace(
        problem=SimpleNamespace(criteria=STANDARD),
        windows=SimpleNamespace(recording=recording),
        travel=np.ptp(np.concatenate([swing, held] * 3), axis=1),
    )
    motion.moves = Motion.moves.fget(motion)  # pyright: ignore[reportOptionalCall, reportArgumentType]
    assert motion.moves.tolist() == ([True] * 6 + [False] * 6) * 3
    fold = _folds(motion)  # pyright: ignore[reportArgumentType]
    assert [int(motion.moves[fold == f].sum()) for f in range(6)] == [3] * 6
    assert all(len(np.unique(recording[fold == f])) == 1 for f in range(6))
    motion.moves[:] = True
    assert np.bincount(_folds(motion)).tolist() == [6] * 6  # pyright: ignore[reportArgumentType]


def test_an_effect_is_no_rival_of_itself_and_what_helps_more_in_parts_alone_is_no_likelier() -> None:
    def group(*effects: Effect) -> Group:
        own = [Hypothesis(e, e.parameters()) for e in effects]
        return Group(tuple(own), tuple((i,) for i in range(len(own))))

    found, dry = ViscousFriction("elbow", 0.1), CoulombFriction("elbow", 0.1)
    everywhere = group(found, ViscousFriction("shoulder", 0.1))
    alternatives = [(everywhere, 3.0), (group(dry), 1.5), (group(CoulombFriction("shoulder", 0.1)), 0.6)]
    confidence, of_family, rivals = _rivals(found, group(found), alternatives, STANDARD)
    assert rivals == [dry]
    assert confidence == pytest.approx(0.5, abs=0.01) and of_family == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("low, told", [(0.02, True), (0.0, False)])
def test_what_may_be_nothing_is_not_told(low: float, told: bool) -> None:
    effect = ViscousFriction("elbow", 0.1)
    finding = Finding.of(effect, {"b": Estimate(0.1, "N m s/rad", low, 0.2)}, 0.8)
    assert _told(effect, finding) is told
