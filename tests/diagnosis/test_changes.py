"""What is told from a change: what runs differ in by themselves, what motors do, and how few recordings are parted."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plants import recordings

from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, write_recording
from keycld_envs.systems import get_system
from keycld_model.diagnosis import Report, diagnose
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.candidates import Columns
from keycld_model.diagnosis.discrepancy.checks import held_still
from keycld_model.diagnosis.discrepancy.detectable import detectable
from keycld_model.diagnosis.discrepancy.missing import Missing
from keycld_model.diagnosis.discrepancy.motion import Motion
from keycld_model.diagnosis.discrepancy.regressors import shared_terms
from keycld_model.diagnosis.output.words import changed_headline
from keycld_model.diagnosis.verdict.report import FitErrors

PENDULUM = get_system("pendulum").compile()


def unmodelled(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    return -0.01 * v * np.abs(v) - 0.05 * np.tanh(v / 0.02)


def viscous(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    return unmodelled(t, q, v, u) - 0.3 * v


def compared(new: list[Recording], baseline: list[Recording]) -> Report:
    return diagnose(new, PENDULUM, baseline=baseline)


def effects(report: Report) -> list[tuple[str, str]]:
    return [(f.effect, f.where["name"]) for f in report.findings]


@pytest.fixture(scope="module")
def before() -> list[Recording]:
    """Of the mechanism as it was."""
    return recordings("pendulum", 3, unmodelled)


@pytest.mark.long
def test_a_single_recording_tests_one_half_by_the_other(before: list[Recording]) -> None:
    (new,) = recordings("pendulum", 3, viscous)[8:]
    report = compared([new], before[:6])
    assert (report.verdict, effects(report)) == ("mismatch", [("viscous_friction", "hinge")])
    (b,) = report.findings[0].parameters.values()
    assert b.low < 0.3 < b.high and report.fit.corrected < 0.5 * report.fit.refitted
    assert report.held_out == [new.id]


@pytest.mark.long
@pytest.mark.parametrize("now, pull, found", [(unmodelled, 1.0, []), (viscous, 0.1, [("viscous_friction", "hinge")])])
def test_what_differs_from_run_to_run_by_itself_is_no_change(
    now: Callable[..., np.ndarray], pull: float, found: list[tuple[str, str]]
) -> None:
    """A cable that hangs otherwise in each run pulls by another constant force."""
    runs = []
    for i, own in enumerate(np.random.default_rng(1).normal(0, pull, 9)):
        force = unmodelled if i < 6 else now
        runs.append(recordings("pendulum", 3, lambda *at, f=force, p=own: f(*at) + p)[i])
    assert effects(compared(runs[6:], runs[:6])) == found


@pytest.mark.long
def test_a_motor_that_does_nothing_near_zero(before: list[Recording]) -> None:
    def weak(u: np.ndarray) -> np.ndarray:
        return np.sign(u) * np.maximum(0, np.abs(u) - 0.3)

    report = compared(recordings("pendulum", 3, unmodelled, command=weak)[5:], before[:5])
    (finding,) = report.findings
    assert finding.effect == "actuator_dead_zone"
    assert finding.parameters["delta"].value == pytest.approx(0.3, rel=0.2)


def test_recordings_of_other_motors_or_units_are_no_baseline(before: list[Recording]) -> None:
    with pytest.raises(InputError, match="actuator_names"):
        compared([replace(r, actuator_names=("elbow",)) for r in before[5:]], before[:5])
    with pytest.raises(InputError, match="action"):
        compared([replace(r, units={"qpos": "rad", "action": "N m"}) for r in before[5:]], before[:5])


def test_the_page_of_what_is_detectable_is_html(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["detectable", str(tmp_path), "--out", str(tmp_path / "least.pdf")]) == 2
    assert "must end in .html" in capsys.readouterr().err


def test_what_is_detectable_is_told_by_place_and_effect(
    before: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for r in before[:3]:
        write_recording(tmp_path / r.id, r)
    page = tmp_path / "least.html"
    assert main(["detectable", str(tmp_path), "--env", "pendulum", "--out", str(page)]) == 0
    printed = capsys.readouterr().out
    (row,) = [line for line in printed.splitlines() if "Viscous friction" in line]
    assert "joint hinge" in row and "N·m·s/rad" in row
    assert "an external pulse" in printed.partition("No size is told of")[2]
    table = page.read_text(encoding="utf-8").partition("<tbody>")[2]
    assert "joint hinge</td><td>Viscous friction" in table and "an external pulse" in table


def test_a_joint_that_is_held_still_is_named_and_not_vouched_for() -> None:
    travel = np.array([[1.0, 2.0], [1.2, 1.5], [0.9, 0.01], [1.1, 0.02]])  # the second hardly moves in two windows
    motion: Any = SimpleNamespace(travel=travel, problem=SimpleNamespace(criteria=STANDARD))
    assert held_still(motion, np.array([True, True, False, False])).tolist() == [False, True]
    errors = FitErrors("", "mrad", 3.0, 2.0, 2.0)
    said = changed_headline("no_mismatch", [], errors, 4, None, {"shoulder": "0.1 N m"}, still=["elbow"])
    assert said.endswith("more would have been found. Nothing is told of elbow, which hardly moves in them.")


def test_headlines_say_how_much_was_not_compared_and_of_how_many() -> None:
    errors = FitErrors("", "mrad", 3.0, 2.0, 2.0)
    said = changed_headline("no_mismatch", [], errors, 4, beyond={"speed of elbow": 0.1, "position of elbow": 0.49})
    assert said.endswith("For 49 % of the time, the position of elbow is beyond the baseline's, and nothing is told.")
    assert "beyond" not in changed_headline("no_mismatch", [], errors, 4, beyond={"position of elbow": 0.1})
    assert changed_headline("undetermined", [], errors, 4, several=False).startswith(
        "Parts of the new recording differ"
    )


def test_motors_that_never_pushed_are_not_told_of() -> None:
    passive = recordings("pendulum", 3, unmodelled)[::3]
    sizes = {d.effect: d.size for d in detectable(passive, PENDULUM) if d.kind == "actuator"}
    assert sizes and all(np.isinf(size) for size in sizes.values()), sizes


def test_few_recordings_are_parted_in_time() -> None:
    def dry(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return -0.3 * np.tanh(v / 0.02) + 0.1 * np.sin(7 * np.sin(3 * t + q))

    motion = Motion.of(recordings("pendulum", 3, dry, number=2), PENDULUM, STANDARD)
    missing = Missing.of(motion, shared_terms(motion, STANDARD, held=True), Columns.of(motion), STANDARD)
    folds = [np.flatnonzero(missing.fold == f) for f in range(missing.fold.max() + 1)]
    assert len(folds) == 6
    for rows in folds:
        begun = motion.windows.begun[rows]
        assert len(set(motion.windows.recording[rows])) == 1
        assert np.all(np.diff(begun) > 0) and np.ptp(begun) < 1.1  # s, of 3
    (best, *_), none = missing.search(lambda what: False)
    assert best.gained(none) > STANDARD.certain
    assert {effect.family for effect in best.effects()} == {"dissipation"}
    asked: list[str] = []
    hasty, _ = missing.search(lambda what: not asked.append(what))
    assert asked == ["sets of 2 effects"] and {len(tried.groups) for tried in hasty} == {1}
