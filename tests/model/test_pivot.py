"""Where the fixed pivot is may be learned: from motion alone, beside everything else as it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_identification import NOISE, PENDULUMS, T, motion, truth

from keycld_model.training.fit import FitWindows

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unoptimised")]
OFF = jnp.asarray([0.06, -0.04])
WINDOW = 12


@pytest.fixture(scope="module")
def known():
    parts, variables = truth(PENDULUMS, (0.6, 0.4))
    seen, actions, start = motion(parts, variables, NOISE)
    batch = {"keypoints": seen[:, :WINDOW], "actions": actions[:, : WINDOW - 1], **start}
    assert seen.shape[1] == T
    return parts, variables, batch


def slope(known, learn_pivot):
    parts, variables, batch = known
    stage = FitWindows(steps=1, batch=1, learning_rate=1e-3, window=WINDOW, learn_pivot=learn_pivot)

    def loss(pivot):
        return stage.loss(parts, {**variables, "dynamics": {**variables["dynamics"], "pivot": pivot}}, batch)[0]

    return jax.jit(jax.grad(loss))


def test_the_pivot_is_found_by_gradient_descent(known):
    true, gradient_of = known[1]["dynamics"]["pivot"], slope(known, learn_pivot=True)
    pivot = true + OFF
    for rate in (0.01,) * 12 + (0.003,) * 12:
        gradient = gradient_of(pivot)
        pivot = pivot - rate * gradient / jnp.linalg.norm(gradient)
    assert float(jnp.linalg.norm(pivot - true)) < 0.15 * float(jnp.linalg.norm(OFF))


def test_it_stays_where_it_was_declared_unless_asked(known):
    gradient = np.asarray(slope(known, learn_pivot=False)(known[1]["dynamics"]["pivot"] + OFF))
    assert gradient.shape == (2,) and not gradient.any()
