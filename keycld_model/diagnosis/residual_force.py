"""A force without a name: a smooth function of the joints' state, where no named effect suffices."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.diagnosis.fit import Fit, Point, Problem

Array = NDArray[np.float64]
BINS = 8
"""Pieces of a window over which the missing force is taken as constant while weights are fitted."""
OWN, COMMON = 24, 40
"""Random features (Rahimi and Recht, 2007) of each joint's own state, and of all states and commands."""
WIDTHS = (0.5, 1.0)
"""Inverse length scales that are tried, in standard deviations of the inputs."""
COUPLINGS = (1.0, 30.0, 1e6)
"""How much more it takes for a force to depend on more than one joint."""
RIDGES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)
"""Prior precisions of weights that are tried, in units of the forces' own."""
ROUNDS = 8
TOLERANCE = 2.0
"""Nats that a round must gain for another one."""


@dataclass(frozen=True, eq=False)
class Features:
    """Smooth functions of positions, velocities and commands.

    Attributes:
        hinge: `[nv]` joints that turn.
        middle: `[d]` mean of the inputs.
        spread: `[d]` their standard deviation.
        frequency: `[d, k]` of the random features.
        phase: `[k]`.
    """

    hinge: NDArray[np.bool_]
    middle: Array
    spread: Array
    frequency: Array
    phase: Array

    @classmethod
    def draw(cls, hinge: NDArray[np.bool_], q: Array, v: Array, u: Array, width: float, seed: int) -> "Features":
        """Features scaled to states `[..., nv]` and commands `[..., nu]`."""
        inputs, joints = _inputs(hinge, q, v, u)
        flat = inputs.reshape(-1, inputs.shape[-1])
        rng = np.random.default_rng(seed)
        frequency = np.zeros((len(joints), len(hinge) * OWN + COMMON))
        for j in range(len(hinge)):
            own, block = joints == j, slice(j * OWN, (j + 1) * OWN)
            frequency[own, block] = width * rng.normal(size=(int(own.sum()), OWN))
        frequency[:, -COMMON:] = width * rng.normal(size=(len(joints), COMMON))
        phase = rng.uniform(0, 2 * np.pi, frequency.shape[1])
        return cls(hinge, flat.mean(axis=0), flat.std(axis=0) + 1e-9, frequency, phase)

    def __call__(self, q: Array, v: Array, u: Array) -> Array:
        """`[..., 1 + d + k]`: one, the inputs, and random cosines."""
        z = np.clip((_inputs(self.hinge, q, v, u)[0] - self.middle) / self.spread, -4, 4)
        waves = np.cos(z @ self.frequency + self.phase)
        waves[..., :-COMMON] *= np.sqrt(2 / OWN)
        waves[..., -COMMON:] *= np.sqrt(2 / COMMON)
        return np.concatenate([np.ones((*z.shape[:-1], 1)), z, waves], axis=-1)

    def precision(self, ridge: float, coupling: float) -> Array:
        """Prior precisions of the features, `[1 + d + k]`."""
        out = np.full(1 + self.frequency.shape[0] + self.frequency.shape[1], ridge)
        out[-COMMON:] *= coupling
        return out


def _inputs(hinge: NDArray[np.bool_], q: Array, v: Array, u: Array) -> tuple[Array, NDArray[np.int64]]:
    """Numbers `[..., d]` that stand for a state and commands, and the joint of each, -1 for commands."""
    angle, joint = q[..., hinge], np.arange(len(hinge))
    owners = np.concatenate([joint[hinge], joint[hinge], joint[~hinge], joint, np.full(u.shape[-1], -1)])
    return np.concatenate([np.sin(angle), np.cos(angle), q[..., ~hinge], v, u], axis=-1), owners


@dataclass(frozen=True, eq=False)
class ResidualForce(Effect):
    """A missing force that no effect of the taxonomy explains, as a function of positions, velocities and commands."""

    id: ClassVar[str] = "unknown"
    family: ClassVar[str] = "unknown"
    kind: ClassVar[str] = "joint"  # pyright: ignore[reportIncompatibleVariableOverride]
    equation: ClassVar[str] = "tau = f(q, qd, u)"

    features: Features | None = field(default=None, repr=False)
    weights: Array | None = field(default=None, repr=False)

    @classmethod
    def candidates(cls, model: mujoco.MjModel) -> tuple["ResidualForce", ...]:
        """None: it is fitted, not searched for."""
        return ()

    def force(self, model: mujoco.MjModel, t: Array, q: Array, v: Array, u: Array) -> Array:
        """Weighted features."""
        if self.features is None or self.weights is None:
            return np.zeros_like(v)
        return self.features(q, v, u) @ self.weights


def fit_residual_force(fit: Fit, rounds: int = ROUNDS, seed: int = 0) -> Fit:
    """Add the force that explains most of what a fit leaves, nuisances refitted beside it.

    Of several widths and priors those are taken that predict best every third recording from the others.
    """
    model = fit.problem.simulator.model
    hinge = np.array([model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE for j in range(model.njnt)])
    paths = _paths(fit.problem, fit.point)
    drawn = [Features.draw(hinge, *paths, width, seed) for width in WIDTHS]
    normal = _Normal.at(fit, paths)
    old = np.zeros((drawn[0](*paths).shape[-1], model.nv))
    priors = [(ridge, coupling) for ridge in RIDGES for coupling in COUPLINGS]
    features = min(drawn, key=lambda f: normal.validate(f, [f.precision(*p) for p in priors], old).min())
    precisions = [features.precision(*p) for p in priors]
    best, weights = fit, old
    for _ in range(rounds):
        prior = precisions[int(normal.validate(features, precisions, weights).argmin())]
        change, values = normal.solve(features, prior, weights)
        for fraction in (1.0, 0.5, 0.2):
            tried = weights + fraction * change
            where = model.joint(int(np.argmax(np.std(features(*paths) @ tried, axis=(0, 1))))).name
            point = best.point.with_effects(*fit.effects, ResidualForce(where, features, tried))
            variant = replace(point.variant, values=point.variant.values + fraction * values)
            new = fit.problem.minimise(replace(point, variant=variant), 3, only_states=True)
            if new.cost < best.cost - TOLERANCE:
                break
        else:
            break
        best, weights = new, tried
        normal = _Normal.at(best, _paths(best.problem, best.point))
    return best


def _paths(problem: Problem, point: Point) -> tuple[Array, Array, Array]:
    """Positions, velocities and commands in the middle of the bins, `[W, B, ...]`."""
    q, v, u = problem.simulator.roll([point.variant], np.zeros(1, int), problem.windows, point.q[None], point.v[None])
    middle = ((np.arange(BINS) + 0.5) * problem.windows.steps / BINS).astype(int)
    return q[0][:, middle], v[0][:, middle], u[0][:, middle]


@dataclass(frozen=True)
class _Normal:
    """Normal equations of nuisances and of forces `[B * nv]` per bin and joint, per window, states eliminated.

    Attributes:
        matrices: `[W, n + B * nv, n + B * nv]`.
        vectors: `[W, n + B * nv]`.
        prior: `[n]` precisions of nuisances.
        values: `[n]` of nuisances.
        paths: see `_paths`.
        recording: `[W]`.
        scale: `[nv]` usual force at each joint, N m or N.
    """

    matrices: Array
    vectors: Array
    prior: Array
    values: Array
    paths: tuple[Array, Array, Array]
    recording: NDArray[np.int64]
    scale: Array

    @classmethod
    def at(cls, fit: Fit, paths: tuple[Array, Array, Array]) -> "_Normal":
        problem, point = fit.problem, fit.point
        linear, _ = problem.linearise(point)
        n, nv = len(problem.spreads), point.q.shape[1]
        columns = np.swapaxes(problem.responses(point, range(nv), BINS), 2, 3).reshape(*linear.residual.shape, -1)
        whole = replace(linear, shared=np.concatenate([linear.shared[..., :n], columns], axis=-1))
        whole = whole.weighted(whole.outlier_weights())
        reduced, residual = whole.project(whole.shared), whole.project(whole.residual[..., None])[..., 0]
        return cls(
            np.einsum("wri,wrj->wij", reduced, reduced),
            np.einsum("wri,wr->wi", reduced, residual),
            problem.spreads**-2,
            point.variant.values,
            paths,
            problem.windows.recording,
            0.2 * problem.simulator.model.dof_M0,
        )

    def solve(self, features: Features, prior: Array, weights: Array) -> tuple[Array, Array]:
        """Changes of weights `[k, nv]` and of nuisances `[n]`."""
        return self._solve(*self._features(features, np.ones(len(self.vectors), dtype=bool)), prior, weights)

    def validate(self, features: Features, priors: Sequence[Array], weights: Array) -> Array:
        """Costs on every third recording after changes of weights from the others, one per prior."""
        test = self.recording % 3 == 2
        if test.all() or not test.any():
            test = np.arange(len(self.recording)) % 3 == 2
        train, (matrix, vector) = self._features(features, ~test), self._features(features, test)
        out = []
        for prior in priors:
            change, values = self._solve(*train, prior, weights)
            x = np.concatenate([values, change.ravel()])
            out.append(0.5 * float(x @ matrix @ x) - float(vector @ x))
        return np.array(out)

    def _solve(self, matrix: Array, vector: Array, prior: Array, weights: Array) -> tuple[Array, Array]:
        n, nv = len(self.prior), len(self.scale)
        precision = np.outer(prior, self.scale**-2).ravel()
        vector = vector.copy()
        vector[:n] -= self.prior * self.values
        vector[n:] -= precision * weights.ravel()
        regular = matrix + np.diag(np.concatenate([self.prior, precision]))
        solution = np.linalg.solve(regular, vector).astype(np.float64)
        return solution[n:].reshape(-1, nv), solution[:n]

    def _features(self, features: Features, used: NDArray[np.bool_]) -> tuple[Array, Array]:
        n, nv = len(self.prior), len(self.scale)
        phi = features(*(path[used] for path in self.paths))  # [W, B, k]
        w, _, k = phi.shape
        spread = np.einsum("wbk,ij->wbikj", phi, np.eye(nv)).reshape(w, BINS * nv, k * nv)
        m, y = self.matrices[used], self.vectors[used]
        cross = np.einsum("wib,wbk->ik", m[:, :n, n:], spread)
        half = m[:, n:, n:] @ spread
        own = np.tensordot(spread, half, axes=([0, 1], [0, 1]))
        matrix = np.block([[m[:, :n, :n].sum(axis=0), cross], [cross.T, own]])
        vector = np.concatenate([y[:, :n].sum(axis=0), np.einsum("wbk,wb->k", spread, y[:, n:])])
        return matrix.astype(np.float64), vector.astype(np.float64)
