"""The band of signals, rollouts, and `keycld delan real` on logs of a simulated pendulum in place of the real one."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keycld_control.cli import main
from keycld_control.delan.logs import all_logs
from keycld_control.delan.real import Trial, results, trials
from keycld_control.delan.real_table import real_table, winners
from keycld_control.delan.rollouts import rollouts
from keycld_envs.errors import InputError
from keycld_model.delan import Motions, read_motions
from keycld_model.delan.baseline import fit_baseline
from keycld_model.delan.filtering import low_pass

from .conftest import INERTIA, WEIGHT, B, waves

T = np.asarray(0.002 * np.arange(4000), np.float64)


def slow(seed: int) -> tuple[np.ndarray, ...]:
    """Positions, velocities, accelerations `[T, 1]` below 1 Hz."""
    return waves(np.random.default_rng(seed), T, 1, 1.0)


def torque(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Of a pendulum with viscous friction."""
    return INERTIA * a + WEIGHT * np.sin(q) + B * v


def test_signals_below_the_band_pass_and_vibrations_do_not() -> None:
    q, v, a = slow(0)
    shake, rate = 2e-3 * np.sin(60 * np.pi * T)[:, None], 60 * np.pi
    motion = low_pass("x", "x", T, q + shake, None, torque(q, v, a), 6.0)
    inner = slice(20, -20)
    at = [np.interp(motion.t, T, x[:, 0]) for x in (q, v, a)]
    for found, true in zip((motion.q, motion.v, motion.a), at, strict=True):
        assert np.abs(found[inner, 0] - true[inner]).max() < 0.01 * true.std()
    assert (2e-3 * rate**2) > 5 * np.abs(a).max()  # of the vibration
    assert 24 <= 1 / np.diff(motion.t).mean() < 27


@pytest.mark.parametrize("measured", [True, False])
def test_standard_deviations_are_those_of_white_noise(measured: bool) -> None:
    (q, v, a), rng = slow(1), np.random.default_rng(0)
    noisy = (q, v + rng.normal(0, 0.1, v.shape)) if measured else (q + rng.normal(0, 0.01, q.shape), None)
    motion = low_pass("x", "x", T, *noisy, torque(q, v, a), 6.0)
    inner = slice(20, -20)
    error = motion.a[inner, 0] - np.interp(motion.t, T, a[:, 0])[inner]
    assert error.std() == pytest.approx(motion.a_std.mean(), rel=0.3)
    assert (motion.v_std == 0).all() == measured


def test_least_squares_find_the_inertia_of_a_robot_that_vibrates_only_below_the_band() -> None:
    q, v, a = slow(2)
    rate = 20 * np.pi
    shake = 0.3 * a.std() / rate**2 * np.sqrt(2) * np.sin(rate * T)[:, None]
    inertias = []
    for band in (6.0, 100.0):
        motion = low_pass("x", "x", T, q + shake, None, torque(q, v, a), band)
        model = fit_baseline(Motions("x", ("hinge",), ("hinge",), (motion,)), ("viscous_friction",))
        inertias.append(float(model.mass_matrix([0.0])[0, 0]))
    assert inertias[0] == pytest.approx(INERTIA, rel=0.01)
    assert inertias[1] < 0.95 * INERTIA


def test_motions_that_a_band_does_not_suit_are_refused(letters: Path) -> None:
    q, v, a = slow(0)
    for t, band in ((T * 25, 6.0), (T, 0.2), (T, float("nan")), (T, -1.0)):
        with pytest.raises(InputError):
            low_pass("x", "x", t, q, v, a, band)
    with pytest.raises(InputError):
        read_motions(letters, band=6.0)


def test_beginnings_and_cuts_keep_every_motion(letters: Path) -> None:
    motions = read_motions(letters)
    assert [len(m.t) for m in motions.beginning(0.25).motions] == [15] * 6
    pieces = motions.cut(10)
    assert len(pieces) == 60
    assert np.array_equal(pieces.all("tau"), motions.all("tau"))


def test_rollouts_of_an_exact_model_stay_with_the_motion(letters: Path) -> None:
    motions = read_motions(letters)
    exact, wrong = fit_baseline(motions), fit_baseline(motions)
    wrong.parameters["equations"]["coefficients"][:] *= np.linspace(
        0.5, 1.5, len(wrong.parameters["equations"]["coefficients"])
    )
    good, bad = rollouts(exact, motions, 1.0), rollouts(wrong, motions, 1.0)
    assert good.number == bad.number == 6 * (59 // 12)
    assert good.median is not None and good.median < 5
    assert good.lost == 0
    assert bad.median is None or bad.median > 5 * good.median


def test_held_out_recordings_are_none_of_those_learned_from() -> None:
    for logs in all_logs().values():
        paths = [{file.path for file in files} for files in (logs.training, logs.held_out)]
        assert all(paths)
        assert not paths[0] & paths[1]


def test_trials_are_distinct_and_wrong_names_refused() -> None:
    planned = trials(seeds=2)
    assert len(set(planned)) == len(planned) == len({trial.name for trial in planned})
    assert {trial.share for trial in planned} == {1.0, 0.25}
    wrong: list[dict[str, Any]] = [{"rigs": ["x"]}, {"models": ["x"]}, {"shares": [0.0]}, {"seeds": 0}, {"band": 0.0}]
    for words in wrong:
        with pytest.raises(InputError):
            trials(**words)
    with pytest.raises(InputError, match="no simulator of KUKA"):
        trials(rigs=["KUKA"], models=["corrected"])
    assert [t.model for t in trials(rigs=["KUKA"], models=["corrected", "structured"], shares=[1.0])] == ["structured"]


def test_the_lower_mean_wins() -> None:
    trial = Trial("arm", "structured")
    lines = [
        {"rig": trial.rig, "share": 1.0, "band": 6.0, "model": model, "torque_share": e, "rollouts": {"median": m}}
        for model, e, m in (("structured", 0.1, 3.0), ("structured", 0.3, 1.0), ("black_box", 0.15, None))
    ]
    assert winners(lines) == [{"rig": "arm", "share": 1.0, "band": 6.0, "torque": "black_box", "rollout": "structured"}]
    assert "**0.150**, inf" in real_table(lines).markdown()
    lines[2]["rollouts"] = None
    assert "**0.150**, indefinite" in real_table(lines).markdown()


def test_real_goes_on_where_it_stopped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = all_logs()["simple pendulum"]
    for seed, file in enumerate((*logs.training, *logs.held_out)):
        q, v, a = slow(seed)
        table = np.column_stack([T, q, v, torque(q, v, a)])
        path = tmp_path / "data" / file.path
        path.parent.mkdir(parents=True)
        np.savetxt(path, table, delimiter=",", header="time,position,velocity,torque", comments="")
    out = tmp_path / "out"
    words = ["delan", "real", str(tmp_path / "data"), "--out", str(out), "--json", "--rig", "simple pendulum"]
    assert main([*words, "--model", "least_squares", "--share", "1"]) == 0
    assert json.loads(capsys.readouterr().out)["winners"] == []  # alone
    first = results(out)
    assert first[0]["torque_share"] < 1e-3  # the band passes a sine of a sum otherwise than the sum
    assert first[0]["effects"]["viscous_friction at hinge"]["b"] == pytest.approx(B, rel=0.02)
    assert main([*words, "--model", "least_squares", "--workers", "2"]) == 0
    again = results(out)
    assert again[0] == first[0]
    assert [line["share"] for line in again] == [1.0, 0.25]
    assert main([*words, "--rig", "nowhere"]) == 2
    assert main(["delan", "real", str(tmp_path), "--out", str(tmp_path / "none"), "--only-report"]) == 2
