"""Closed-form solves, null spaces, Runge-Kutta."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from keycld_model.numerics import null_space, rk4_step, solve_positive_definite

pytestmark = pytest.mark.usefixtures("unoptimised", "x64")


def positive_definite(n: int, seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(n, n + 2))
    return root @ root.T


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_solve_agrees_with_numpy(n):
    for seed in range(5):
        a, b = positive_definite(n, seed), np.random.default_rng(seed + 50).normal(size=n)
        np.testing.assert_allclose(solve_positive_definite(jnp.asarray(a), jnp.asarray(b)), np.linalg.solve(a, b))


def test_solve_of_nothing():
    assert solve_positive_definite(jnp.zeros((0, 0)), jnp.zeros(0)).shape == (0,)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_gradient_of_solve_agrees_with_the_inverse_function(n):
    a, b, w = jnp.asarray(positive_definite(n, 1)), jnp.arange(1.0, n + 1), jnp.ones(n)
    ours = jax.grad(lambda a, b: w @ solve_positive_definite(a, b), (0, 1))(a, b)
    inverse = np.linalg.inv(a)
    np.testing.assert_allclose(ours[1], inverse @ w, rtol=1e-9)
    full = -np.outer(inverse @ w, inverse @ b)  # the solve reads the lower triangle of a only
    np.testing.assert_allclose(np.tril(ours[0]), np.tril(full + np.tril(full.T, -1)), rtol=1e-9)


def test_regularisation_is_relative_to_the_mean_of_the_diagonal():
    a, b = positive_definite(3, 2), np.array([1.0, -2.0, 3.0])
    expected = np.linalg.solve(a + 0.1 * np.trace(a) / 3 * np.eye(3), b)
    np.testing.assert_allclose(solve_positive_definite(jnp.asarray(a), jnp.asarray(b), 0.1), expected)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("a", [np.zeros((2, 2)), np.ones((2, 2)), np.ones((4, 4))])
def test_a_singular_system_has_a_finite_solution_and_gradient(a, dtype):
    a, b = jnp.asarray(a, dtype), jnp.ones(len(a), dtype)

    def total(a, b):
        return jnp.sum(solve_positive_definite(a, b, 1e-6))

    if np.any(a):
        assert np.isfinite(total(a, b))
        assert all(np.isfinite(g).all() for g in jax.grad(total, (0, 1))(a, b))
    assert np.isfinite(total(a, 0 * b))


@pytest.mark.parametrize(("c", "n"), [(0, 2), (1, 2), (2, 4), (3, 4), (3, 8)])
def test_null_space(c, n):
    a = jnp.asarray(np.random.default_rng(c).normal(size=(c, n)))
    basis = null_space(a)
    assert basis.shape == (n, n - c)
    np.testing.assert_allclose(basis.T @ basis, np.eye(n - c), atol=1e-12)
    np.testing.assert_allclose(a @ basis, np.zeros((c, n - c)), atol=1e-12)


def test_runge_kutta_is_of_fourth_order():
    def pendulum(x, v):
        return -9.81 * jnp.sin(x) - 0.3 * v

    def after_one_second(steps):
        x, v = jnp.array([2.0]), jnp.array([0.5])
        for _ in range(steps):
            x, v = rk4_step(pendulum, x, v, 1 / steps)
        return np.concatenate([x, v])

    exact = after_one_second(2000)
    sizes = np.array([20, 40, 80])
    errors = [np.abs(after_one_second(n) - exact).max() for n in sizes]
    slopes = -np.diff(np.log(errors)) / np.diff(np.log(sizes))
    np.testing.assert_allclose(slopes, 4, atol=0.2)
