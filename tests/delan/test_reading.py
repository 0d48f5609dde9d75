"""Motions from archives, recordings and logs; what is refused; velocities and accelerations from positions."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, write_recording
from keycld_model.delan import read_motions
from keycld_model.delan.smoothing import smooth

T = 0.01 * np.arange(400, dtype=np.float64)


def test_smoothing_gives_derivatives_and_their_uncertainty() -> None:
    rng = np.random.default_rng(0)
    q = np.stack([np.sin(3 * T), 0.5 * np.cos(2 * T)], axis=1)
    v, a = np.stack([3 * np.cos(3 * T), -np.sin(2 * T)], axis=1), np.stack([-9 * np.sin(3 * T), -2 * np.cos(2 * T)], 1)
    noisy = q + 0.003 * rng.standard_normal(q.shape)
    noisy[50] = np.nan
    found = smooth(T, noisy)
    assert found.noise == pytest.approx(np.full(2, 0.003), rel=0.15)
    assert np.sqrt(np.mean((found.v - v) ** 2, axis=0)).max() < 0.05
    assert np.sqrt(np.mean((found.a - a) ** 2, axis=0)).max() < 0.5
    assert 0.3 < np.sqrt(np.mean(((found.a - a) / found.a_std) ** 2)) < 3


def test_archives_are_read_and_parted(letters: Path) -> None:
    motions = read_motions(letters)
    assert (motions.ids, motions.kinds, len(motions.all("q"))) == (tuple("abcdef"), ("hinge", "hinge"), 360)
    rest, test = motions.hold_out(["b", "e"])
    assert (rest.ids, test.ids) == (tuple("acdf"), ("b", "e"))
    learned, held = rest.split(0.25, seed=3)
    assert sorted(learned.ids + held.ids) == sorted(rest.ids) and len(held) == 1
    parts = [test.truth(name) for name in ("inertial", "coriolis", "gravity")]
    assert sum(p for p in parts if p is not None) == pytest.approx(test.all("tau"))


def test_archives_of_positions_alone_get_derivatives(letters: Path) -> None:
    arrays = dict(np.load(letters))
    v, a = arrays.pop("qv"), arrays.pop("qa")
    np.savez(letters, **arrays)
    motions = read_motions(letters)
    assert np.sqrt(np.mean((motions.all("v") - v) ** 2)) < 0.05 * v.std()
    assert np.sqrt(np.mean((motions.all("a") - a) ** 2)) < 0.15 * a.std()
    assert (motions.all("a_std") > 0).all()


@pytest.mark.parametrize(
    "damage",
    [
        lambda x: x.pop("tau"),
        lambda x: x.pop("qp"),
        lambda x: x.update(tau=0 * x["tau"]),
        lambda x: x.update(qp=0 * x["qp"] + 0.1, qv=0 * x["qv"], qa=0 * x["qa"]),
        lambda x: x.update(qp=np.rad2deg(x["qp"])),
        lambda x: x.update(qp=np.rad2deg(x["qp"]), qv=np.rad2deg(x["qv"])),
        lambda x: x.update(qv=np.rad2deg(x["qv"])),
        lambda x: x.update(qp=np.full_like(x["qp"], np.nan)),
        lambda x: x.update(lengths=x["lengths"] + 1),
        lambda x: x.update(labels=np.array(list("aacdef"))),
        lambda x: x.update(tau=x["tau"][:, :1]),
        lambda x: (x.pop("qa"), x.pop("t")),
        lambda x: (x.pop("qa"), x.update(t=x["t"][::-1])),
        lambda x: (
            x.pop("qa"),
            x.update({k: y[::15] for k, y in x.items() if len(y) == 360}, lengths=x["lengths"] // 15),
        ),
    ],
)
def test_archives_that_make_no_sense_are_refused(damage: Callable[[dict], object], letters: Path) -> None:
    arrays = dict(np.load(letters))
    damage(arrays)
    np.savez(letters, **arrays)
    with pytest.raises(InputError, match=r"letters\.npz"):
        read_motions(letters).scales()


def test_rates_that_are_too_low_for_accelerations_are_refused(letters: Path) -> None:
    arrays = dict(np.load(letters))
    t = 0.7 * np.arange(60)  # of sines whose periods are 1.6 s and more
    q = np.sin(4 * t[:, None] + np.array([0.0, 1.0]))
    np.savez(letters, t=t, qp=q, tau=arrays["tau"][:60])
    with pytest.raises(InputError, match="samples/s"):
        read_motions(letters)


def recording(**changes: object) -> Recording:
    """A joint under a torque of steps."""
    values = {
        "id": "run",
        "source": "real",
        "joint_names": ("elbow",),
        "actuator_names": ("motor",),
        "units": {"action": "2 N m", "qpos": "rad"},
        "t_action": T[::10],
        "action": np.arange(40.0)[:, None],
        "t_state": T,
        "qpos": np.sin(2 * T)[:, None],
    }
    return Recording(**(values | changes))  # type: ignore[arg-type]


def test_recordings_give_torques_in_newton_metres(tmp_path: Path) -> None:
    write_recording(tmp_path / "set" / "run", recording())
    for path in (tmp_path / "set", tmp_path / "set" / "run"):
        motions = read_motions(path)
        assert (motions.joints, motions.kinds) == (("elbow",), ("hinge",))
        tau = motions.all("tau")[:, 0]
        assert tau[[5, 15, 205]] == pytest.approx([0.0, 2.0, 40.0])  # in the middle of steps
        assert tau[10] == pytest.approx(1.0)  # at an edge, the mean of both
        assert motions.all("v")[100:300, 0] == pytest.approx(2 * np.cos(2 * T[100:300]), abs=0.02)
    learned, held = motions.split(0.2, 0)
    assert len(learned) + len(held) == 10  # parts of the single recording


@pytest.mark.parametrize(
    "changes",
    [
        {"t_action": None, "action": None, "actuator_names": ()},
        {"units": {"action": "V", "qpos": "rad"}},
        {"action": np.ones((40, 2)), "actuator_names": ("left", "right")},
        {"qpos": np.full((400, 1), np.nan)},
    ],
)
def test_recordings_without_torques_are_refused(changes: dict, tmp_path: Path) -> None:
    write_recording(tmp_path / "run", recording(**changes))
    with pytest.raises(InputError, match="run"):
        read_motions(tmp_path / "run")
