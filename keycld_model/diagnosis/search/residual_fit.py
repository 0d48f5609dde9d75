"""Fits a residual force, where no named effect suffices."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from keycld_envs.effects import Effect
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.estimation.push_responses import push_responses
from keycld_model.diagnosis.estimation.replay import replay
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.simulator import usual_forces
from keycld_model.rigid_body.residual_force import Features, ResidualForce

Array = NDArray[np.float64]
ROUNDS = 8
"""Gauss-Newton steps of the weights at most; two where there is hardly anything to explain."""
LEAST_GAIN = 0.5
"""Nats that a step must gain for another one."""


def fit_residual_force(fit: Fit, rounds: int = ROUNDS, seed: int = 0) -> Fit:
    """Add the force that explains most of what a fit leaves, nuisances refitted beside it.

    Of several widths and priors the most probable are taken; again near the end, where rollouts are nearly linear in
    the force. Where they are far from that, the force is first fitted on shorter windows. Without one that fits better,
    the fit comes back as it is.
    """
    start = fit
    if fit.chi_square > 30.0:
        short = replace(fit.problem, windows=fit.problem.windows.shorter(4))
        start = replay(fit.problem, _added(replay(short, fit), fit.effects, rounds, seed), 12)
    best = _added(start, fit.effects, rounds, seed)
    return best if best.cost < fit.cost else fit


def _added(start: Fit, named: Sequence[Effect], rounds: int, seed: int) -> Fit:
    """With a force beside named effects, fitted from a start that may have one."""
    model, paths = start.problem.simulator.model, _paths(start)
    hinge = np.array([model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE for j in range(model.njnt)])
    drawn = [Features.draw(hinge, *paths, width, seed) for width in (0.5, 1.0, 2.0)]  # inverse length scales
    none = np.zeros((drawn[0](*paths).shape[-1], model.nv))
    couplings = (1.0, 30.0, 1e6)  # how much more it takes for a force to depend on more than one joint
    drivings = (1.0, 1e6) if np.any(paths[2]) else (1e6,)  # and for a motor's to depend on positions
    priors = list(itertools.product(10.0 ** np.arange(-4, 3), couplings, drivings))
    choices = [ResidualForce("", f, none, f.precision(*prior)) for f in drawn for prior in priors]
    best = start
    for _ in range(2):
        normal = _Normal.at(best)
        force = choices[int(normal.evidence(choices).argmax())]
        weights, values = normal.solve(force)
        new = _descend(_moved(best, named, replace(force, weights=weights), values), rounds)
        if new.cost > best.cost - LEAST_GAIN:
            break
        best = new
    return best


def lengthened(fit: Fit, problem: Problem, rounds: int = ROUNDS, seed: int = 0) -> Fit:
    """A fit with a residual force, fitted on to longer windows of the same recordings, in which errors pile up.

    They also tell its width and prior better. The force is then at the joint where it explains most.
    """
    start = replay(problem, fit, 12)
    longer = _added(start, fit.effects[:-1], rounds, seed)
    return _placed(replay(fit.problem, _descend(start, rounds) if longer is start else longer))


def freedom(fit: Fit) -> float:
    """Number of weights that recordings tell of a residual force, the others being as its prior has them.

    The trace of the smoother (Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, section 7.6).
    """
    force = residual_force_of(fit)
    return 0.0 if force is None else _Normal.at(fit).freedom(force)


def residual_force_of(fit: Fit) -> ResidualForce | None:
    """The residual force, which is the last of a fit's effects."""
    last = fit.effects[-1] if fit.effects else None
    return last if isinstance(last, ResidualForce) else None


def _moved(fit: Fit, named: Sequence[Effect], force: ResidualForce, values: Array) -> Fit:
    """A fit with another force and nuisances, and states fitted to them."""
    point = fit.point.with_effects(*named, force)
    return minimise(fit.problem, replace(point, variant=replace(point.variant, values=values)), 3, only_states=True)


def _placed(fit: Fit) -> Fit:
    """With its residual force at the joint where it explains most."""
    force = residual_force_of(fit)
    if force is None:
        return fit
    where = int(_Normal.at(fit).worth(force).argmax())
    there = replace(force, where=fit.problem.simulator.model.joint(where).name)
    return replace(fit, point=fit.point.with_effects(*fit.effects[:-1], there))


def _descend(fit: Fit, rounds: int) -> Fit:
    """Gauss-Newton on the weights of a fit's residual force; the prior stays as it is."""
    scale = usual_forces(fit.problem.simulator.model)
    for _ in range(rounds):
        force, old = residual_force_of(fit), fit.point.variant.values
        if force is None:
            break
        weights, values = _Normal.at(fit).solve(force)
        for fraction in (1.0, 0.5, 0.2, 0.1):
            tried = replace(force, weights=force.weights + fraction * (weights - force.weights))
            new = _moved(fit, fit.effects[:-1], tried, old + fraction * (values - old))
            if new.cost + tried.penalty(scale) < fit.cost + force.penalty(scale) - LEAST_GAIN:
                break
        else:
            break
        fit = new
    return fit


def _parts(windows: Windows) -> int:
    """Pieces, of five samples, over which the missing force is taken as constant while weights are fitted."""
    return max(1, windows.samples // 5)


def _paths(fit: Fit) -> tuple[Array, Array, Array]:
    """Positions, velocities and commands in the middle of the pieces, `[W, B, ...]`."""
    edges = fit.problem.windows.edges(_parts(fit.problem.windows))
    middle = (edges[1:] + edges[:-1]) // 2
    q, v, u = fit.problem.path(fit.point)
    return q[:, middle], v[:, middle], u[:, middle]


@dataclass(frozen=True)
class _Normal:
    """Normal equations of nuisances and of forces `[B * nv]` per piece and joint, per window, states eliminated.

    Attributes:
        matrices: `[W, n + B * nv, n + B * nv]`.
        vectors: `[W, n + B * nv]`.
        prior: `[n]` precisions of nuisances.
        paths: see `_paths`.
        scale: `[nv]` usual force at each joint, N m or N.
    """

    matrices: Array
    vectors: Array
    prior: Array
    paths: tuple[Array, Array, Array]
    scale: Array

    @classmethod
    def at(cls, fit: Fit) -> "_Normal":
        problem, point, paths = fit.problem, fit.point, _paths(fit)
        linear, _ = problem.linearise(point)
        n, nv = len(problem.spreads), point.q.shape[1]
        responses = push_responses(problem, point, range(nv), _parts(problem.windows))
        columns = np.swapaxes(responses, 2, 3).reshape(*linear.residual.shape, -1)
        whole = replace(linear, shared=np.concatenate([linear.shared[..., :n], columns], axis=-1))
        whole = whole.weighted(whole.huber_weights(problem.criteria.significant))
        reduced, residual = whole.project(whole.shared), whole.project(whole.residual[..., None])[..., 0]
        matrices, force = np.einsum("wri,wrj->wij", reduced, reduced), residual_force_of(fit)
        here = np.zeros(matrices.shape[:2])
        here[:, :n] = point.variant.values
        if force is not None:
            here[:, n:] = (force.features(*paths) @ force.weights).reshape(len(here), -1)
        return cls(
            matrices,
            np.einsum("wri,wr->wi", reduced, residual) + np.einsum("wij,wj->wi", matrices, here),
            problem.spreads**-2,
            paths,
            usual_forces(problem.simulator.model),
        )

    def solve(self, force: ResidualForce) -> tuple[Array, Array]:
        """Weights `[k, nv]` and nuisances `[n]`."""
        matrix, vector = self._equations(force.features)
        low, scale = _factored(matrix + np.diag(self._prior(force)))
        solution = cho_solve((low, True), vector / scale, check_finite=False) / scale
        return solution[len(self.prior) :].reshape(-1, len(self.scale)), solution[: len(self.prior)]

    def freedom(self, force: ResidualForce) -> float:
        """Number of weights that are told, beside nuisances."""
        matrix, _ = self._equations(force.features)
        low, scale = _factored(matrix + np.diag(self._prior(force)))
        told = cho_solve((low, True), matrix / scale[:, None], check_finite=False) / scale[:, None]
        return float(np.trace(told[len(self.prior) :, len(self.prior) :]))

    def worth(self, force: ResidualForce) -> Array:
        """Twice the nats `[nv]` that a fit loses without the force at each joint, nuisances fitted again."""
        n, nv = len(self.prior), len(self.scale)
        push = force.features(*self.paths) @ force.weights
        matrices, out = self.matrices, np.zeros(nv)
        nuisances = matrices[:, :n, :n].sum(axis=0) + np.diag(self.prior)
        for j in range(nv):
            alone = (push * (np.arange(nv) == j)).reshape(len(matrices), -1)
            cross = np.einsum("wib,wb->i", matrices[:, :n, n:], alone)
            own = np.einsum("wb,wbc,wc->", alone, matrices[:, n:, n:], alone)
            out[j] = own - cross @ np.linalg.solve(nuisances, cross)
        return out

    def evidence(self, forces: Sequence[ResidualForce]) -> Array:
        """Logarithm of the marginal likelihood of each force's features and prior, nats up to a constant.

        MacKay, Bayesian interpolation (1992).
        """
        drawn = {id(force.features): force.features for force in forces}
        equations = {key: self._equations(features) for key, features in drawn.items()}
        return np.array([self._evidence(*equations[id(force.features)], force) for force in forces])

    def _evidence(self, matrix: Array, vector: Array, force: ResidualForce) -> float:
        prior = self._prior(force)
        low, scale = _factored(matrix + np.diag(prior))
        explained = solve_triangular(low, vector / scale, lower=True, check_finite=False)
        volume = np.log(np.diag(low)).sum() + np.log(scale).sum()
        return 0.5 * float(explained @ explained + np.log(prior).sum()) - float(volume)

    def _prior(self, force: ResidualForce) -> Array:
        """Precisions of nuisances, then of weights."""
        return np.concatenate([self.prior, np.outer(force.precision, self.scale**-2).ravel()])

    def _equations(self, features: Features) -> tuple[Array, Array]:
        """Normal equations of nuisances and weights, without their prior."""
        n, nv = len(self.prior), len(self.scale)
        phi = features(*self.paths)  # [W, B, k]
        w, parts, k = phi.shape
        spread = np.einsum("wbk,ij->wbikj", phi, np.eye(nv)).reshape(w, parts * nv, k * nv)
        m, y = self.matrices, self.vectors
        cross = np.einsum("wib,wbk->ik", m[:, :n, n:], spread)
        half = m[:, n:, n:] @ spread
        own = np.tensordot(spread, half, axes=([0, 1], [0, 1]))
        matrix = np.block([[m[:, :n, :n].sum(axis=0), cross], [cross.T, own]])
        vector = np.concatenate([y[:, :n].sum(axis=0), np.einsum("wbk,wb->k", spread, y[:, n:])])
        return matrix.astype(np.float64), vector.astype(np.float64)


def _factored(matrix: Array) -> tuple[Array, Array]:
    """L and s with matrix = diag(s) L L' diag(s) up to rounding, which stiff stops lift above the priors."""
    scale = np.sqrt(np.diag(matrix))
    low = np.linalg.cholesky(matrix / np.outer(scale, scale) + 1e-11 * np.eye(len(matrix)))
    return np.asarray(low, np.float64), scale
