"""Linear algebra in single numbers, each an array over rollouts: what is zero by construction costs nothing.

The numbers 0.0 and 1.0 as Python floats are exactly that, and never get into a program.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

Traced = jax.Array
"""An array while a program is traced, over N rollouts as a rule."""
Scalar = Traced | float
"""A single number of each of N rollouts, `[N]`, or one that is the same in all."""
Vector = tuple[Scalar, Scalar, Scalar]
Matrix = tuple[Vector, Vector, Vector]
Constants = tuple[float, float, float]
"""A vector of numbers that are the same in all rollouts."""
State = TypeVar("State")


def solve(matrix: Sequence[Sequence[Scalar]], right: Sequence[Scalar]) -> list[Scalar]:
    """Solution of a positive definite system, by its L D L' factors."""
    n = len(right)
    low: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    diagonal: list[Scalar] = []
    x = list(right)
    for j in range(n):
        d = matrix[j][j]
        for k in range(j):
            d = d - mul(mul(low[j][k], low[j][k]), diagonal[k])
        diagonal.append(d)
        for i in range(j + 1, n):
            value = matrix[i][j]
            for k in range(j):
                value = subtract(value, mul(mul(low[i][k], low[j][k]), diagonal[k]))
            low[i][j] = 0.0 if _is(value, 0.0) else value / d
    for i in range(n):
        for k in range(i):
            x[i] = subtract(x[i], mul(low[i][k], x[k]))
    x = [value / d for value, d in zip(x, diagonal, strict=True)]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            x[i] = subtract(x[i], mul(low[k][i], x[k]))
    return x


def _is(a: Scalar, value: float) -> bool:
    """Whether a number is one by construction."""
    return isinstance(a, float) and a == value


def mul(a: Scalar, b: Scalar) -> Scalar:
    """Product of numbers."""
    if _is(a, 0.0) or _is(b, 0.0):
        return 0.0
    return b if _is(a, 1.0) else a if _is(b, 1.0) else a * b


def add(a: Scalar, b: Scalar) -> Scalar:
    """Sum of numbers."""
    return b if _is(a, 0.0) else a if _is(b, 0.0) else a + b


def subtract(a: Scalar, b: Scalar) -> Scalar:
    """Difference of numbers."""
    return a if _is(b, 0.0) else -b if _is(a, 0.0) else a - b


def dot(a: Vector, b: Vector) -> Scalar:
    """Inner product of vectors."""
    return add(add(mul(a[0], b[0]), mul(a[1], b[1])), mul(a[2], b[2]))


def cross(a: Vector, b: Vector) -> Vector:
    """Cross product of vectors."""
    return (
        subtract(mul(a[1], b[2]), mul(a[2], b[1])),
        subtract(mul(a[2], b[0]), mul(a[0], b[2])),
        subtract(mul(a[0], b[1]), mul(a[1], b[0])),
    )


def plus(a: Vector, b: Vector) -> Vector:
    """Sum of vectors."""
    return add(a[0], b[0]), add(a[1], b[1]), add(a[2], b[2])


def minus(a: Vector, b: Vector) -> Vector:
    """Difference of vectors."""
    return subtract(a[0], b[0]), subtract(a[1], b[1]), subtract(a[2], b[2])


def scaled(s: Scalar, a: Vector) -> Vector:
    """A number times a vector."""
    return mul(s, a[0]), mul(s, a[1]), mul(s, a[2])


def turned(matrix: Matrix, a: Vector) -> Vector:
    """A matrix times a vector."""
    return dot(matrix[0], a), dot(matrix[1], a), dot(matrix[2], a)


def product(a: Matrix, b: Matrix) -> Matrix:
    """Product of matrices."""
    one, two, three = zip(*b, strict=True)
    first, second, third = ((dot(row, one), dot(row, two), dot(row, three)) for row in a)
    return first, second, third


def sine_and_cosine(angle: Traced) -> tuple[Traced, Traced]:
    """Sine and cosine to 1e-15, by polynomials: the compiler's own take most of the time of a step."""
    quarter = jnp.round(angle * (2 / math.pi))
    x = (angle - quarter * (math.pi / 2)) - quarter * 6.123233995736766e-17
    square = x * x
    sine: Scalar = 0.0
    cosine: Scalar = 0.0
    for n in range(17, 0, -2):
        sine = add(mul(square, sine), (-1.0) ** (n // 2) / math.factorial(n))
        cosine = add(mul(square, cosine), (-1.0) ** (n // 2) / math.factorial(n - 1))
    turns = quarter.astype(jnp.int32) & 3
    odd = (turns & 1) == 1
    s, c = jnp.where(odd, cosine, x * sine), jnp.where(odd, x * sine, cosine)
    return jnp.where(turns >= 2, -s, s), jnp.where((turns == 1) | (turns == 2), -c, c)


class Quick:
    """JAX's functions, with quicker ones where the compiler's own are slow; to 1e-15."""

    @staticmethod
    def sin(x: Traced) -> Traced:
        """Sine."""
        return sine_and_cosine(x)[0]

    @staticmethod
    def cos(x: Traced) -> Traced:
        """Cosine."""
        return sine_and_cosine(x)[1]

    @staticmethod
    def tanh(x: Traced) -> Traced:
        """Hyperbolic tangent."""
        return 1 - 2 / (jnp.exp(2 * x) + 1)

    @staticmethod
    def repeated(number: int, step: Callable[[State], State], state: State) -> State:
        """A loop that is compiled once."""
        return jax.lax.fori_loop(0, number, lambda _, now: step(now), state)

    @staticmethod
    def if_any(condition: Traced, then: Callable[[], State], otherwise: Callable[[], State]) -> State:
        """One branch or the other, of which only one is computed."""
        return jax.lax.cond(jnp.any(condition), then, otherwise)

    def __getattr__(self, name: str) -> Any:
        return getattr(jnp, name)


def rotation(axis: Constants, angle: Traced) -> Matrix:
    """Rotation about a unit axis (Rodrigues)."""
    s, c = sine_and_cosine(angle)
    x, y, z = axis
    across = (0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)

    def entry(i: int, j: int) -> Scalar:
        if i == j and abs(axis[i]) == 1:
            return 1.0
        return add(add(c if i == j else 0.0, mul(s, across[i][j])), mul(axis[i] * axis[j], 1 - c))

    first, second, third = ((entry(i, 0), entry(i, 1), entry(i, 2)) for i in range(3))
    return first, second, third
