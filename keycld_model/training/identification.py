"""Second-order identification of what few numbers describe: masses, where they are, and linear forces.

Masses, their places on the rods and the scale of the forces nearly compensate for each other over half a second of
motion. Gradient descent creeps along that valley for thousands of steps; Gauss-Newton crosses it in a few.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from numpy.typing import NDArray

from keycld_model.modules import Parts
from keycld_model.training.coordinates import HUBER, Coordinates, programs
from keycld_model.training.stage import Variables

RIDGE = 1e-9
"""Relative; holds directions that the recordings do not determine, such as forces along a rod."""
ATTEMPTS = 6
"""Steps tried, each ten times more cautious, before the fit counts as converged."""
CONVERGED = 1e-6
"""Relative gain of a step below which the fit counts as converged."""
NEGLIGIBLE = 0.01
"""A motor's influence on a keypoint, relative to its greatest on any, that hardly differs from none."""
ABSENT = 0.03
"""Influence below which a motor does not act on a keypoint."""
LEAN = 0.03
"""Standard deviation of `lean` before it is known; the fit after the next distillation finds what this held back."""

Vector = NDArray[np.float64]


def identify(
    parts: Parts,
    variables: Variables,
    keypoints: Array | NDArray[np.float32],
    actions: NDArray[np.float32],
    iterations: int,
    slide: bool = True,
    sparse: bool = False,
    acting: bool = False,
) -> Variables:
    """Fit masses, their places, levels, linear terms of V and g, and all initial states, to keypoints at once.

    A Levenberg-Marquardt fit with Huber weights; the initial state of each sequence is eliminated by a Schur
    complement, as in bundle adjustment (Triggs et al., Bundle Adjustment: A Modern Synthesis, 2000).

    A motor acts on few keypoints, as a rule on those beside its joint. If `sparse`, each pair of a motor and a keypoint
    costs as many parameters as describe it by the Bayesian information criterion; otherwise a force of the cart's motor
    on the pole looks like the inertia of the pole, and the place of the pole's mass is free. The count is made smooth
    as in Frommlet and Nuel, An Adaptive Ridge Procedure for L0 Regularization (2016), for groups. What
    a parameter must gain follows from the median deviation at each step.

    If `acting`, what acts is then fitted without that price, which also weighs on what is there, and together with how
    far keypoints lean along their rails: a lean is told from the mass of a pole only by where motors do not act. If
    that explains keypoints worse than the price was worth, what was fitted with it stays. Keypoints must be good for
    this: where a motor is left out by mistake, the lean is wrong.

    Args:
        parts: the networks; V and g must have linear terms.
        variables: "dynamics", "rod_scale", "lean" and "trajectories" to start from.
        keypoints: `[N, T, n]` as measured (before `to_masses`).
        actions: `[N, T-1, m]`.
        iterations: at most this many steps; if acting, as many again without the price.
        slide: also fit where masses are.
        sparse: let motors act on few keypoints.
        acting: leave out where motors do not act, and let keypoints lean.

    Returns:
        Variables with these four replaced.
    """
    problem = Problem(parts, variables, keypoints, actions, slide, at_masses=acting)
    fit = Fit(problem.start, variables["trajectories"]["x"], variables["trajectories"]["v"])
    lean = problem.where("lean")
    fit, cost = minimise(problem, fit, iterations, problem.price if sparse else np.zeros_like, ~lean)
    if acting:
        absent = problem.absent(fit.theta)
        fewer = fit._replace(theta=np.where(absent, 0, fit.theta))
        fewer, without = minimise(problem, fewer, iterations, lambda _: lean / LEAN**2, ~absent)
        fit = fewer if without <= cost else fit
    found = problem.coordinates.variables(problem.first, jnp.asarray(fit.theta, jnp.float32))
    return {**variables, **found, "trajectories": {"x": fit.x, "v": fit.v}}


class Fit(NamedTuple):
    """Shared parameters `[p]` and the initial states `[N, n]` of all sequences."""

    theta: Vector
    x: Array
    v: Array


def minimise(
    problem: "Problem", fit: Fit, iterations: int, price: Callable[[Vector], Vector], free: NDArray[np.bool_]
) -> tuple[Fit, float]:
    """Levenberg-Marquardt on deviations and the price of the parameters that are free.

    The price gives second derivatives `[p]` of a penalty at a noise of one. Returns the fit, and its cost and price.
    """
    damping, cost = 1e-5, np.inf
    for _ in range(iterations):
        blocks = problem.blocks(fit)
        ridge = price(fit.theta) * np.median(blocks.cost) / problem.mechanism.num_keypoints
        cost = before = blocks.cost.sum() + 0.5 * ridge @ fit.theta**2
        for _ in range(ATTEMPTS):
            shared, own = blocks.step(ridge, ridge * fit.theta, damping, free)
            costs, new = problem.try_step(fit, shared, own)
            after = costs.sum() + 0.5 * ridge @ new.theta**2
            if after < before:
                break
            damping *= 10
        else:
            break
        fit, cost, damping = new, after, max(damping / 10, 1e-10)
        if cost > (1 - CONVERGED) * before:
            break
    return fit, float(cost)


class Blocks(NamedTuple):
    """Gauss-Newton approximation of every sequence's cost in p shared parameters and s of its own.

    Attributes:
        hessian: `[N, p+s, p+s]`.
        gradient: `[N, p+s]`.
        cost: `[N]`.
    """

    hessian: Vector
    gradient: Vector
    cost: Vector

    def step(self, ridge: Vector, pull: Vector, damping: float, free: NDArray[np.bool_]) -> tuple[Vector, Vector]:
        """The step of the shared parameters `[p]` and of the sequences' own `[N, s]`; zero if all have diverged.

        Args:
            ridge: `[p]`, second derivatives of the penalty.
            pull: `[p]`, its gradient.
            damping: of Levenberg and Marquardt.
            free: `[p]`, parameters that move.
        """
        p = len(ridge)
        good = np.isfinite(self.hessian).all((1, 2)) & np.isfinite(self.gradient).all(1)
        if not good.any():
            return np.zeros(p), np.zeros((len(self.cost), self.gradient.shape[1] - p))
        h, g = self.hessian[good], self.gradient[good]
        own, cross = h[:, p:, p:], h[:, p:, :p]
        diagonal = np.einsum("nii->ni", own)
        own = own + (damping * diagonal + 1e-9)[:, :, None] * np.eye(own.shape[1])
        solved = np.linalg.solve(own, np.concatenate([cross, g[:, p:, None]], axis=-1))
        shared = h[:, :p, :p].sum(0) - np.einsum("nsp,nsq->pq", cross, solved[..., :-1]) + np.diag(ridge)
        right = g[:, :p].sum(0) + pull - np.einsum("nsp,ns->p", cross, solved[..., -1])
        diagonal, moving = np.diag(shared)[free], np.ix_(free, free)
        first = np.zeros(p)
        first[free] = -np.linalg.solve(
            shared[moving] + np.diag(damping * diagonal + RIDGE * diagonal.mean()), right[free]
        )
        second = np.zeros((len(self.cost), own.shape[1]))
        second[good] = -(solved[..., -1] + solved[..., :-1] @ first)
        return first, second


class Problem:
    """Costs of all sequences and their derivatives."""

    def __init__(
        self,
        parts: Parts,
        variables: Variables,
        keypoints: Array | NDArray[np.float32],
        actions: NDArray[np.float32],
        slide: bool,
        at_masses: bool,
    ) -> None:
        self.mechanism, self.sequences = parts.config.mechanism, len(keypoints)
        self.coordinates = Coordinates(parts.config, slide, at_masses)
        self.first = {name: variables[name] for name in ("dynamics", "rod_scale", "lean")}
        parameters, self._unravel = ravel_pytree(self.coordinates.parameters(self.first))
        self.start = np.asarray(parameters, np.float64)
        self._data = jnp.asarray(keypoints), jnp.asarray(actions)
        self._blocks, self._costs, self._linearised = programs(self.coordinates)

    def price(self, theta: Vector) -> Vector:
        """Second derivatives `[p]` of the penalty on influences of motors on keypoints, at a noise of one.

        The errors of keypoints go with the pose and hardly average out within a recording, so the frames of one count
        as a single measurement.
        """
        p = self.named(theta)
        mass, square = self._influences(p)
        size = 2 * (2 * self.mechanism.num_keypoints + 1)
        price = np.log(self.sequences) * size / (square + NEGLIGIBLE**2 * square.max(axis=0)) / mass
        return self._of_influences(p, price)

    def absent(self, theta: Vector) -> NDArray[np.bool_]:
        """`[p]` parameters of those influences of motors on keypoints that hardly differ from none."""
        p = self.named(theta)
        _, square = self._influences(p)
        return self._of_influences(p, square < ABSENT**2 * square.max(axis=0)) > 0

    def named(self, theta: Vector) -> dict[str, Array]:
        """Parameters `[p]` by name."""
        return self._unravel(jnp.asarray(theta, jnp.float32))

    def where(self, name: str) -> NDArray[np.bool_]:
        """`[p]` parameters of one name."""
        p = self.named(self.start)
        marked = {key: jnp.full_like(value, key == name) for key, value in p.items()}
        return np.asarray(ravel_pytree(marked)[0]) > 0

    def _influences(self, p: dict[str, Array]) -> tuple[Array, Array]:
        """Masses `[K, 1]`, squared forces of motors `[K, m]` as Gauss's principle of least constraint counts them."""
        n, mass = 2 * self.mechanism.num_keypoints, jax.nn.softmax(p["inertia"])[:, None]
        linear = jnp.sum(p["input"].reshape(n, n // 2, 2, -1) ** 2, axis=(0, 2))
        constant = jnp.sum(p["constant_input"].reshape(n // 2, 2, -1) ** 2, axis=1)
        return mass, (linear + constant) / mass

    def _of_influences(self, p: dict[str, Array], value: Array) -> Vector:
        """Values `[K, m]` of influences as values `[p]` of the parameters that they consist of, zero for others."""
        value = jnp.repeat(jnp.asarray(value, jnp.float32), 2, axis=0)
        values = {
            **jax.tree.map(jnp.zeros_like, p),
            "input": jnp.broadcast_to(value, p["input"].shape),
            "constant_input": value,
        }
        return np.asarray(ravel_pytree(values)[0], np.float64)

    def blocks(self, fit: Fit) -> Blocks:
        """Second-order pictures of the costs of all sequences."""
        hessian, gradient, cost = self._blocks(
            self.first, jnp.asarray(fit.theta, jnp.float32), fit.x, fit.v, *self._data
        )
        return Blocks(np.asarray(hessian, np.float64), np.asarray(gradient, np.float64), self._bounded(cost))

    def linearised(self, fit: Fit) -> tuple[Array, Array, Array, Vector]:
        """Deviations `[N, T*n]`, their derivatives `[N, T*n, p+s]`, weights `[N, T*n]`, and costs `[N]`."""
        *rows, cost = self._linearised(self.first, jnp.asarray(fit.theta, jnp.float32), fit.x, fit.v, *self._data)
        return *rows, self._bounded(cost)

    def try_step(self, fit: Fit, shared: Vector, own: Vector) -> tuple[Vector, Fit]:
        """Costs `[N]` after a step of the parameters `[p]` and of the states `[N, s]`, and the fit after it."""
        theta = fit.theta + shared
        moved = jnp.asarray(theta, jnp.float32), jnp.asarray(own, jnp.float32)
        cost, x, v = self._costs(self.first, *moved, fit.x, fit.v, *self._data)
        return self._bounded(cost), Fit(theta, x, v)

    def _bounded(self, cost: Array) -> Vector:
        """A trajectory that diverges costs as if all its keypoints were an image unit away."""
        bound = HUBER * self.mechanism.num_keypoints
        return np.nan_to_num(np.minimum(np.asarray(cost, np.float64), bound), nan=bound)
