"""Second-order identification of what few numbers describe: masses, where they are, and linear forces.

Masses, their places on the rods and the scale of the forces nearly compensate for each other over half a second of
motion. Gradient descent creeps along that valley for thousands of steps; Gauss-Newton crosses it in a few.
"""

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from numpy.typing import NDArray

from keycld_model.modules import Parts
from keycld_model.numerics import evenly_spaced
from keycld_model.physics import lumped
from keycld_model.places import to_masses
from keycld_model.training.actuation import joint_forces
from keycld_model.training.coordinates import HUBER, Coordinates, programs
from keycld_model.training.stage import Variables

RIDGE = 1e-9
"""Relative; holds directions that the recordings do not determine, such as forces along a rod."""
ATTEMPTS = 6
"""Steps tried, each ten times more cautious, before the fit counts as converged."""
CONVERGED = 1e-6
"""Relative gain of a step below which the fit counts as converged."""
LOST = 10.0
"""Cost of a recording, relative to a typical one's, from which its trajectory is another one's."""
NEGLIGIBLE = 0.01
"""A motor's influence on a keypoint, relative to its greatest on any, that hardly differs from none."""
ABSENT = 0.03
"""Influence below which a motor does not act on a keypoint."""
POSES = 200
"""On which forces of any kind are compared with those at joints."""
ELSEWHERE = 0.1
"""Share of the work of motors that forces at joints do not do, below which motors act at joints: training leaves some
percent, and a fan in place of a motor is of the order of one."""
IDLE = 1e-3
"""Work of a force, relative to the most that one of its size does, below which the fit with a price begins without it:
recordings do not tell of it, and numerical errors have made it anything."""
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

    Motors act at joints, as a rule (see `joint_forces`). If forces may be anything, one of the cart's motor on the pole
    looks like the inertia of the pole, and the place of the pole's mass is free. If `sparse`, forces at joints are
    fitted first, then others, each pair of a motor and a keypoint at the price of as many parameters as describe it, by
    the Bayesian information criterion; the cheaper of the two stays. That count is made smooth
    as in Frommlet and Nuel, An Adaptive Ridge Procedure for L0 Regularization (2016), for groups. What
    a parameter must gain follows from the median deviation at each step.

    If `acting`, keypoints may lean along their rails, too, which is told from the mass of a pole only by where motors
    do not act. Where they act elsewhere than at joints, what acts is once more fitted without that price, which also
    weighs on what is there; if that explains keypoints worse than the price was worth, what was fitted with it stays.
    Keypoints must be good for this: where a motor is left out by mistake, the lean is wrong.

    Args:
        parts: the networks; V and g must have linear terms.
        variables: "dynamics", "rod_scale", "lean" and "trajectories" to start from.
        keypoints: `[N, T, n]` as measured (before `to_masses`).
        actions: `[N, T-1, m]`.
        iterations: at most this many steps; if acting, as many again without the price.
        slide: also fit where masses are.
        sparse: let motors act at joints, or on few keypoints.
        acting: leave out where motors do not act, and let keypoints lean.

    Returns:
        Variables with these four replaced.
    """
    problem = Problem(parts, variables, keypoints, actions, slide, at_masses=acting)
    fit = Fit(problem.start, variables["trajectories"]["x"], variables["trajectories"]["v"])
    fit = _sparse(problem, fit, iterations, acting) if sparse else minimise(problem, fit, iterations)[0]
    found = problem.coordinates.variables(problem.first, jnp.asarray(fit.theta, jnp.float32))
    return {**variables, **found, "trajectories": {"x": fit.x, "v": fit.v}}


def along(free: NDArray[np.bool_]) -> Vector:
    """`[p, q]` axes of those of p parameters that move."""
    return np.eye(len(free))[:, free]


class Fit(NamedTuple):
    """Shared parameters `[p]` and the initial states `[N, n]` of all sequences."""

    theta: Vector
    x: Array
    v: Array


def _sparse(problem: "Problem", fit: Fit, iterations: int, acting: bool) -> Fit:
    """Forces at joints, unless other ones explain more than their price."""
    lean = problem.where("lean")
    still, hardly = (np.zeros_like(lean), lambda _: lean / LEAN**2) if acting else (lean, np.zeros_like)
    directions = problem.directions_at_joints(still)
    joints, cost = minimise(problem, problem.with_motors_at_joints(fit)[0], iterations, hardly, directions)
    cost += problem.worth(problem.costs(joints), problem.forces_at_joints.shape[1])
    anything, other = minimise(problem, problem.without_idle_forces(fit), iterations, problem.price)
    if acting:
        absent = problem.absent(anything.theta)
        fewer = anything._replace(theta=np.where(absent, 0, anything.theta))
        fewer, without = minimise(problem, fewer, iterations, hardly, along(~absent))
        if without <= other:
            anything, other = fewer, without
    return joints if cost <= other else anything


def minimise(
    problem: "Problem",
    fit: Fit,
    iterations: int,
    price: Callable[[Vector], Vector] = np.zeros_like,
    directions: Vector | None = None,
    again: bool = True,
) -> tuple[Fit, float]:
    """Levenberg-Marquardt on deviations and the price of the parameters.

    With wrong masses, some recordings end on another trajectory; these begin again where they began, with the masses
    that the others told.

    Args:
        problem: what is explained.
        fit: to start from.
        iterations: at most this many steps.
        price: second derivatives `[p]` of a penalty at a noise of one.
        directions: `[p, q]`, in which parameters move; by default all but `lean`.
        again: let recordings that were lost begin again, and go on.

    Returns:
        The fit, and its cost and price.
    """
    start = fit
    if directions is None:
        directions = along(~problem.where("lean"))
    damping, cost = 1e-5, np.inf
    for _ in range(iterations):
        blocks = problem.blocks(fit)
        ridge = price(fit.theta) * problem.noise(blocks.cost)
        cost = before = blocks.cost.sum() + 0.5 * ridge @ fit.theta**2
        for _ in range(ATTEMPTS):
            shared, own = blocks.step(ridge, ridge * fit.theta, damping, directions)
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
    if again and (lost := problem.lost(fit, start)).any():
        x, v = (jnp.where(lost[:, None], old, new) for old, new in ((start.x, fit.x), (start.v, fit.v)))
        return minimise(problem, Fit(fit.theta, x, v), iterations, price, directions, again=False)
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

    def step(self, ridge: Vector, pull: Vector, damping: float, directions: Vector) -> tuple[Vector, Vector]:
        """The step of the shared parameters `[p]` and of the sequences' own `[N, s]`; zero if nothing is left finite.

        Args:
            ridge: `[p]`, second derivatives of the penalty.
            pull: `[p]`, its gradient.
            damping: of Levenberg and Marquardt.
            directions: `[p, q]`, in which they move.
        """
        p = len(ridge)
        good = np.isfinite(self.hessian).all((1, 2)) & np.isfinite(self.gradient).all(1)
        nothing = np.zeros(p), np.zeros((len(self.cost), self.gradient.shape[1] - p))
        if not good.any() or not np.isfinite(ridge).all() or not np.isfinite(pull).all():
            return nothing
        h, g = self.hessian[good], self.gradient[good]
        own, cross = h[:, p:, p:], h[:, p:, :p]
        diagonal = np.einsum("nii->ni", own)
        own = own + (damping * diagonal + 1e-9)[:, :, None] * np.eye(own.shape[1])
        solved = np.linalg.solve(own, np.concatenate([cross, g[:, p:, None]], axis=-1))
        shared = h[:, :p, :p].sum(0) - np.einsum("nsp,nsq->pq", cross, solved[..., :-1]) + np.diag(ridge)
        right = g[:, :p].sum(0) + pull - np.einsum("nsp,ns->p", cross, solved[..., -1])
        moving = directions.T @ shared @ directions
        diagonal = np.diag(moving)
        moving = moving + np.diag(damping * diagonal + RIDGE * diagonal.mean())
        first = -directions @ np.linalg.solve(moving, directions.T @ right)
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
        fine: bool = False,
    ) -> None:
        self.mechanism, self.sequences = parts.config.mechanism, len(keypoints)
        self.coordinates = Coordinates(parts.config, slide, at_masses, fine)
        self.first = {name: variables[name] for name in ("dynamics", "rod_scale", "lean")}
        parameters, self._unravel = ravel_pytree(self.coordinates.parameters(self.first))
        self.start = np.asarray(parameters, np.float64)
        self._data = jnp.asarray(keypoints), jnp.asarray(actions)
        self._blocks, self._costs, self._linearised = programs(self.coordinates)

    @cached_property
    def forces_at_joints(self) -> Vector:
        """`[p, c*m]` directions of parameters: a unit of each motor at each rod and slider."""
        p, motors = self.named(self.start), range(self.mechanism.num_actions)
        nothing = jax.tree.map(jnp.zeros_like, p)
        forces = [
            {
                **nothing,
                "input": nothing["input"].at[:, :, motor].set(linear),
                "constant_input": nothing["constant_input"].at[:, motor].set(constant),
            }
            for linear, constant in zip(*joint_forces(self.mechanism, self.first["dynamics"]["pivot"]), strict=True)
            for motor in motors
        ]
        flat = [np.asarray(ravel_pytree(force)[0], np.float64) for force in forces]
        return np.array(flat).reshape(-1, len(self.start)).T  # of no motors, none

    def directions_at_joints(self, still: NDArray[np.bool_]) -> Vector:
        """`[p, q]` in which parameters move that are no forces of motors, but for some `[p]`, and forces at joints."""
        return np.hstack([along(~(still | self._of_motors)), self.forces_at_joints])

    def with_motors_at_joints(self, fit: Fit) -> tuple[Fit, bool]:
        """The same with those forces of motors at joints that do most nearly the work that its forces do.

        Returns:
            The fit, and whether these do nearly all of that work.
        """
        forces = np.where(self._of_motors, fit.theta, 0)
        works = self._works(np.vstack([forces, self.forces_at_joints.T]))
        sizes = np.linalg.lstsq(works[1:].T, works[0], rcond=None)[0]
        left = np.linalg.norm(works[0] - works[1:].T @ sizes) / max(np.linalg.norm(works[0]), np.finfo(float).tiny)
        return fit._replace(theta=fit.theta - forces + self.forces_at_joints @ sizes), bool(left < ELSEWHERE)

    def without_idle_forces(self, fit: Fit) -> Fit:
        """The same without forces of motors that do no work: along rods, across rails, on what is held."""
        units = along(self._of_motors)
        works = self._works(units.T).T
        working = np.linalg.pinv(works, rcond=IDLE) @ works
        return fit._replace(theta=np.where(self._of_motors, units @ working @ units.T @ fit.theta, fit.theta))

    @cached_property
    def _of_motors(self) -> NDArray[np.bool_]:
        """`[p]` parameters of forces of motors."""
        return self.where("input") | self.where("constant_input")

    def _works(self, thetas: Vector) -> Vector:
        """`[b, w]` forces of motors along what can move, for parameters `[b, p]`, in poses from all recordings."""
        seen = self._data[0].reshape(-1, 2 * self.mechanism.num_keypoints)
        seen = seen[evenly_spaced(len(seen), POSES)]
        x = to_masses(self.mechanism, self.first, seen) if self.coordinates.at_masses else seen
        model = self.coordinates.parts.lagrangian(self.first)
        free = jax.vmap(model.tangent_space)(x)

        def works(theta: Array) -> Array:
            p = self._unravel(theta)
            force = jnp.einsum("xi,iju->xju", x, p["input"]) + p["constant_input"]
            return jnp.einsum("xjd,xju->xdu", free, force).ravel()

        return np.asarray(jax.vmap(works)(jnp.asarray(thetas, jnp.float32)), np.float64)

    def noise(self, cost: Vector) -> float:
        """Squared error of a coordinate in a typical sequence, of costs `[N]` of all."""
        return float(np.median(cost)) / self.mechanism.num_keypoints

    def worth(self, cost: Vector, count: int) -> float:
        """What so many parameters must gain, by the Bayesian information criterion; costs as in `noise`.

        The errors of keypoints go with the pose and hardly average out within a recording, so the frames of one count
        as a single measurement.
        """
        return 0.5 * count * np.log(self.sequences) * self.noise(cost)

    def price(self, theta: Vector) -> Vector:
        """Second derivatives `[p]` of the penalty on influences of motors on keypoints, at a noise of one.

        See `worth`.
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
        n, mass = 2 * self.mechanism.num_keypoints, lumped(self.mechanism, jax.nn.softmax(p["inertia"]))[:, None]
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

    def lost(self, fit: Fit, start: Fit) -> NDArray[np.bool_]:
        """`[N]` recordings that are far from their keypoints, and less so from the states of another fit."""
        now = self.costs(fit)
        far = now > LOST * np.median(now)
        return far & (self.costs(start._replace(theta=fit.theta)) < now) if far.any() else far

    def costs(self, fit: Fit) -> Vector:
        """`[N]`."""
        still = np.zeros((self.sequences, 2 * self.mechanism.degrees_of_freedom))
        return self.try_step(fit, np.zeros_like(self.start), still)[0]

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
