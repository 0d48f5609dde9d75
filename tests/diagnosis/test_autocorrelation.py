"""Over how many samples errors are alike."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.search.criterion import dispersion
from keycld_model.image_alignment.calibration import frames_together


def errors(share: float, samples: int, columns: int, seed: int = 0) -> np.ndarray:
    """Of which each keeps a share of the one before."""
    rng, out = np.random.default_rng(seed), np.empty((samples, columns))
    out[0] = rng.normal(size=columns)
    for k in range(1, samples):
        out[k] = share * out[k - 1] + np.sqrt(1 - share**2) * rng.normal(size=columns)
    return out


def test_errors_that_last_count_as_fewer_samples():
    """(1 + r)/(1 - r) of a first-order process."""
    lasting, new = errors(0.6, 4000, 1), errors(0.0, 4000, 1, 1)
    assert frames_together([np.hstack([lasting, new])]) == pytest.approx([4.0, 1.0], rel=0.15)
    assert np.array_equal(frames_together([lasting[:1]]), [1.0])


def test_recordings_count_by_their_length_and_from_their_own_mean():
    parts = [errors(0.6, 1500, 1, seed) + 5 * seed for seed in range(3)]
    assert frames_together(parts) == pytest.approx([4.0], rel=0.2)


def test_a_misfit_that_lasts_is_dispersed_the_more():
    def fit(share: float) -> Any:
        residual = 2 * errors(share, 200, 60).T[..., None]  # [windows, samples, channels]
        problem = SimpleNamespace(samples=residual.size, windows=SimpleNamespace(samples=200), criteria=STANDARD)
        cost = 0.5 * float(np.sum(residual**2))
        return SimpleNamespace(
            problem=problem, cost=cost, residual=residual, hessian=(), point=SimpleNamespace(q=np.zeros(0))
        )

    assert dispersion(fit(0.0)) == pytest.approx(4.0, rel=0.05)
    assert dispersion(fit(0.6)) == pytest.approx(16.0, rel=0.15)
