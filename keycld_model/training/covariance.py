"""How far off identification may be: errors within a recording go together, and errors that go with the pose in all.

Least squares that believed every keypoint to err by itself would be far too sure. Errors of an estimator of keypoints
have two parts here. What is left of a recording is a single draw (a sandwich estimator, with the correction of Bell and
McCaffrey, Bias Reduction in Standard Errors for Linear Regression with Multi-Stage Samples, 2002). What the pose
determines is the same in all recordings, so that no number of them averages it out: a random function of the rods'
angles, whose size is told by what of it the motion leaves in the deviations (expectation
maximisation for variance components: Dempster, Laird and Rubin 1977). What is told of it is made up for. Part of it
looks like other masses and forces; that part is as large as the part that does not. What is seen of a part is nearer
to the camera than its joints are, and so looks larger: all that a rod carries seems to be farther out, which nothing in
the motion tells, and what slides seems to be faster. How much is known from models that were trained.
"""

from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from numpy.typing import NDArray
from scipy.linalg import eigh

from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_envs.recordings import Dataset
from keycld_envs.registration import same_system
from keycld_model.modules import Parts
from keycld_model.places import carried, is_joint
from keycld_model.training.coordinates import Coordinates
from keycld_model.training.data import TrainingData, check_fits
from keycld_model.training.fit import fit_states
from keycld_model.training.identification import LEAN, Fit, Problem, along, minimise
from keycld_model.training.stage import Variables
from keycld_model.uncertainty import Uncertainty, numbers_of
from keycld_model.world_model import WorldModel

ORDER, FUNCTIONS = 3, 64
"""Highest harmonic of the rods' angles, fewer if there are more functions of a pose than that."""
CONSTANT, HARMONIC, NEARER = 0, 1, 2
NEARER_LINK, NEARER_CART = 0.004, 0.015
"""Standard deviations of how much larger parts look than at their joints' distance from the camera, as a share: of rods
between two joints, and of ways along a rail, since carts are thicker."""
ITERATIONS = 20
"""Gauss-Newton steps, at most."""
FEWEST = 3
"""Sequences that tell of a spread between sequences."""
ROUNDS = 200
"""Of expectation maximisation."""
TOLD = 0.1
"""Share of a function of the pose that other masses and forces must leave in the deviations, to tell its size."""
UNKNOWN = 3.0
"""Standard deviation of what recordings do not determine, relative to the largest of its kind."""
Vector = NDArray[np.float64]


def measure_uncertainty(
    parts: Parts, variables: Variables, keypoints: NDArray[np.float32], actions: NDArray[np.float32]
) -> Uncertainty | None:
    """Identify once more with everything free that motion can tell, and see how far off that may be.

    Args:
        parts: the networks; V and g must have linear terms.
        variables: the trained model; "trajectories" `[N, n]`, if known, to start from.
        keypoints: `[N, T, n]` of its estimator, image units.
        actions: `[N, T-1, m]`.

    Returns:
        None if too few sequences could be followed, they tell too little, or V and g have no linear terms.
    """
    if not parts.config.networks.identifiable:
        return None
    there = jnp.zeros(parts.config.mechanism.num_keypoints)
    variables = {**variables, "rod_scale": there, "lean": there}
    if "trajectories" not in variables:
        variables["trajectories"] = _trajectories(parts, variables, keypoints, actions)
    roughly, finely = (
        Problem(parts, variables, keypoints, actions, slide=True, at_masses=True, fine=fine) for fine in (False, True)
    )
    try:
        return _measured(roughly, finely, variables, keypoints)
    except np.linalg.LinAlgError:  # what was recorded tells so little that the equations are singular
        return None


def with_uncertainty(model: WorldModel, dataset: Dataset) -> WorldModel:
    """The same model, which knows how far masses, lengths, V and g may be off.

    Args:
        model: trained.
        dataset: recordings of its mechanism; of those that it was trained on, the held-out ones stay apart.

    Raises:
        InputError: if recordings do not fit, too few can be followed, or V and g of the model have no linear terms.
    """
    if model.system is not None and dataset.system is not None and not same_system(model.system, dataset.system):
        raise InputError(
            f"{model.name} is a model of {model.system}, {dataset.folder} records {dataset.system}; measure on "
            "recordings of its own system."
        )
    meta = model.meta or {}
    if meta.get("data", {}).get("sha256") == dataset.sha256:
        dataset = dataset.split(meta["validation"])[0]
    data = TrainingData.from_dataset(dataset, meta.get("length", 50))
    check_fits(data, model.config, dataset)
    keypoints = model.keypoints(data.flat_frames).reshape(data.num_sequences, data.length, -1)
    found = measure_uncertainty(model.parts, dict(model.parameters), keypoints, data.actions)
    if found is None:
        raise InputError(
            f"{model.name} has no masses that are linear in what moves, or follows too few of {dataset.folder}, or too "
            "little moves in them; use a model of the preset default, and recordings in motion that it predicts well."
        )
    return replace(model, uncertainty=found)


def _measured(
    roughly: Problem, problem: Problem, variables: Variables, keypoints: NDArray[np.float32]
) -> Uncertainty | None:
    """What `measure_uncertainty` returns; a fit with few steps of integration comes first.

    Raises:
        LinAlgError: if the equations are singular.
    """
    states = variables["trajectories"]
    absent, lean = problem.absent(problem.start), problem.where("lean")
    fit, free = Fit(np.where(absent, 0, problem.start), states["x"], states["v"]), along(~absent)
    at_joints, nearly = problem.with_motors_at_joints(fit)
    if nearly:
        fit, free = at_joints, problem.directions_at_joints(np.zeros_like(absent))
    for each in (roughly, problem):
        fit, _ = minimise(each, fit, ITERATIONS, lambda _: lean / LEAN**2, free)
    pivot = np.asarray(variables["dynamics"]["pivot"])
    sums = _sums(problem, fit, _functions(problem.mechanism, pivot, keypoints), free)
    return None if sums is None else _uncertainty(problem, fit, sums)


def _trajectories(
    parts: Parts, variables: Variables, keypoints: NDArray[np.float32], actions: NDArray[np.float32]
) -> Variables:
    """Initial states of all sequences, from their first frames to all of them."""
    start = None
    for frames in (12, keypoints.shape[1] // 2, keypoints.shape[1]):
        shown = jnp.asarray(keypoints[:, :frames])
        start = fit_states(parts, variables, shown, actions[:, : shown.shape[1] - 1], start)
    return start or {}


def _uncertainty(problem: Problem, fit: Fit, sums: "_Sums") -> Uncertainty:
    """A Gaussian of low rank around an optimum."""
    basis = _of_fixed_total(problem.coordinates, fit.theta, problem.first, sums.free)
    prior = (sums.free.T * _prior(problem, fit.theta)) @ sums.free * sums.noise
    inverse = basis @ np.linalg.inv(basis.T @ (sums.hessian + prior) @ basis) @ basis.T
    amplitudes, unsure = _amplitudes(sums, inverse)
    each = _by_recording(sums, basis, prior, amplitudes)
    by_pose = inverse @ sums.mixed.sum(axis=0)
    spread = each.T @ each + by_pose @ unsure @ by_pose.T + inverse @ prior @ inverse * sums.noise
    middle = fit.theta.copy()
    middle -= sums.free @ by_pose @ amplitudes
    values, vectors = np.linalg.eigh(spread)
    large = values > 1e-9 * values.max()
    root = (sums.free @ vectors[:, large] * np.sqrt(values[large])).T
    return _stored(problem.coordinates, problem.first, middle, root, sums)


def _by_recording(sums: "_Sums", basis: Vector, prior: Vector, amplitudes: Vector) -> Vector:
    """`[N, p]` of which the squares' sum is the covariance, were errors of recordings independent.

    Errors by the pose, as far as they are known, are taken out. A recording that decides much has pulled the fit its
    way, for which Bell and McCaffrey make up.
    """
    root = np.linalg.cholesky(np.linalg.inv(basis.T @ (sums.hessian + prior) @ basis))
    there = basis @ root
    scores = sums.gradients + sums.mixed @ amplitudes
    scores = (scores - scores.mean(axis=0)) @ there
    values, vectors = np.linalg.eigh(there.T @ sums.hessians @ there)
    raised = np.einsum("nij,ni->nj", vectors, scores) / np.sqrt(1 - np.clip(values, 0, 0.9))
    return np.einsum("nij,nj->ni", vectors, raised) @ there.T


class _Sums(NamedTuple):
    """Normal equations over all sequences, whose own initial states have been eliminated.

    Attributes:
        free: `[P, p]` directions in which the shared parameters move.
        kind: `[f]` of each function of the pose, constant or harmonic.
        nearer: `[f, j]` their amplitudes for a standard deviation of how much larger each part looks.
        hessian: `[p, p]` of the shared parameters, along these directions.
        hessians: `[N, p, p]` of every sequence.
        gradients: `[N, p]` of every sequence.
        mixed: `[N, p, f]` of these with amplitudes of functions of the pose.
        functions: `[f, f]` of the amplitudes.
        answers: `[N, f]` their gradients.
        noise: squared error of a coordinate in a typical sequence.
        spread: its root, errors beyond the usual limited.
        correlation: of errors in frames that follow each other.
    """

    free: Vector
    kind: NDArray[np.intp]
    nearer: Vector
    hessian: Vector
    hessians: Vector
    gradients: Vector
    mixed: Vector
    functions: Vector
    answers: Vector
    noise: float
    spread: float
    correlation: float


def _sums(problem: Problem, fit: Fit, functions: "_Functions", free: Vector) -> _Sums | None:
    """Sequences that diverged are left out; None if fewer than `FEWEST` are left."""
    errors, jacobians, weights, costs = problem.linearised(fit)
    features = functions.features
    n, t, p = 2 * problem.mechanism.num_keypoints, features.shape[1], free.shape[1]
    good = np.isfinite(costs) & np.asarray(jnp.isfinite(jacobians).all((1, 2)) & jnp.isfinite(errors).all(1))
    if good.sum() < FEWEST:
        return None
    total, hessians, mixed, gradients = 0.0, [], [], []
    for i in np.flatnonzero(good):
        jacobian, shapes = np.asarray(jacobians[i], np.float64), np.kron(features[i], np.eye(n))
        rows, own = np.hstack([jacobian[:, : len(free)] @ free, shapes]), jacobian[:, len(free) :]
        weighted = own.T * np.asarray(weights[i], np.float64)
        inner = weighted @ own
        inner += 1e-9 * np.trace(inner) * np.eye(len(inner))
        rows = rows - own @ np.linalg.solve(inner, weighted @ rows)
        weighted = rows.T * np.asarray(weights[i], np.float64)
        squares = weighted @ rows
        total += squares
        hessians.append(squares[:p, :p].astype(np.float32))
        mixed.append(squares[:p, p:].astype(np.float32))
        gradients.append(weighted @ np.asarray(errors[i], np.float64))
    gradients = np.array(gradients)
    noise = float(np.median(costs[good]) / problem.mechanism.num_keypoints)
    limit = 3 * np.sqrt(noise)
    usual = np.clip(np.asarray(errors)[good].reshape(-1, t, n), -limit, limit)
    correlation = (usual[:, 1:] * usual[:, :-1]).mean() / (usual**2).mean()
    total = np.asarray(total)
    return _Sums(
        free,
        functions.kind,
        functions.nearer,
        total[:p, :p],
        np.array(hessians),
        gradients[:, :p],
        np.array(mixed),
        total[p:, p:],
        gradients[:, p:],
        noise,
        float(np.sqrt((usual**2).mean())),
        float(np.clip(correlation, 0, 1)),
    )


def _amplitudes(sums: _Sums, inverse: Vector) -> tuple[Vector, Vector]:
    """Likely amplitudes `[f]` of functions of the pose, and their covariance `[f, f]` given what is told of them.

    Args:
        sums: normal equations.
        inverse: `[p, p]` of the shared parameters' Hessian.
    """
    mixed = sums.mixed.sum(axis=0)
    solved = inverse @ mixed
    seen = sums.functions - mixed.T @ solved
    answers = sums.gradients @ solved - sums.answers
    whole = sums.functions + 1e-9 * np.trace(sums.functions) * np.eye(len(sums.kind))
    share, directions = eigh(seen, whole)  # directions.T @ whole @ directions = 1
    told = directions[:, share > TOLD]
    answers, share = answers @ told, share[share > TOLD]
    noise = (answers**2 / share).sum() / max(len(share), 1)
    seen, sought = (whole @ told * share) @ told.T @ whole, whole @ told @ answers.sum(0)
    each = np.hstack([np.eye(len(sums.kind)), sums.nearer])
    kind = np.concatenate([sums.kind, np.full(sums.nearer.shape[1], NEARER)])
    seen, sought = each.T @ seen @ each, each.T @ sought
    size = np.where(kind == NEARER, 1, sums.noise)
    likely, left = np.zeros(len(kind)), np.diag(size)
    for _ in range(ROUNDS):
        left = np.linalg.inv(np.diag(1 / size) + seen / noise)
        likely = left @ sought / noise
        squared = likely**2 + np.diag(left)
        means = np.array([squared[kind == k].mean() for k in kind])
        size = np.where(kind == NEARER, 1, np.maximum(means, 1e-12))
    return each @ likely, each @ left @ each.T


class _Functions(NamedTuple):
    """What errors may go with.

    Attributes:
        features: `[N, T, h]` harmonics of the rods' angles, and ways along rails.
        kind: `[f]` of each for each coordinate, f = h n.
        nearer: `[f, j]` their amplitudes for a standard deviation of how much larger each part looks.
    """

    features: Vector
    kind: NDArray[np.intp]
    nearer: Vector


def _functions(mechanism: Mechanism, pivot: Vector, keypoints: NDArray[np.float32]) -> _Functions:
    """Harmonics of the rods' angles, ways along rails, and which of them parts that look larger are."""
    points = keypoints.reshape(*keypoints.shape[:2], -1, 2).astype(np.float64)
    rods = [points[:, :, r.end] - (pivot if r.start is None else points[:, :, r.start]) for r in mechanism.rods]
    angles = np.stack([np.arctan2(r[..., 0], r[..., 1]) for r in rods], -1) if rods else points[:, :, :0, 0]
    largest = ORDER
    while len(_multiples(len(rods), largest)) * 2 > FUNCTIONS:
        largest -= 1
    multiples = _multiples(len(rods), largest)
    turned = angles @ np.array(multiples, float).reshape(len(multiples), len(rods)).T
    ways = [(points[:, :, slider.keypoint] - pivot) @ slider.along for slider in mechanism.sliders]
    features = np.stack([np.ones(turned.shape[:2]), *ways], -1)
    features = np.concatenate([features, np.sin(turned), np.cos(turned)], -1)
    kind = np.repeat([CONSTANT, HARMONIC], [1, features.shape[-1] - 1])
    nearer = []
    for way, slider in enumerate(mechanism.sliders):
        shift = np.zeros((features.shape[-1], *points.shape[2:]))
        shift[1 + way, list(carried(mechanism, slider.keypoint))] = NEARER_CART * np.asarray(slider.along)
        nearer.append(shift.ravel())
    for r, rod in enumerate(mechanism.rods):
        if not is_joint(mechanism, rod.end):
            continue
        shift = np.zeros((features.shape[-1], *points.shape[2:]))
        sine = 1 + len(ways) + multiples.index(tuple(int(i == r) for i in range(len(rods))))
        out = NEARER_LINK * np.median(np.linalg.norm(rods[r], axis=-1))
        for k in carried(mechanism, rod.end):
            shift[sine, k, 0] = shift[sine + len(multiples), k, 1] = out
        nearer.append(shift.ravel())
    kind = np.repeat(kind, keypoints.shape[-1])
    return _Functions(features, kind, np.array(nearer).reshape(-1, len(kind)).T)


def _multiples(rods: int, largest: int) -> list[tuple[int, ...]]:
    """Whole multiples of the angles of rods, up to a sum, one of each pair of opposites."""
    found = product(range(-largest, largest + 1), repeat=rods)
    return [m for m in found if 0 < sum(map(abs, m)) <= largest and m > tuple(-i for i in m)]


def _of_fixed_total(coordinates: Coordinates, theta: Vector, first: Variables, free: Vector) -> Vector:
    """Orthonormal basis `[p, p-1]` of the changes that leave the total mass, which motion does not tell.

    Args:
        coordinates: of the parameters.
        theta: `[P]`, where.
        first: variables that the parameters replace.
        free: `[P, p]` directions in which they move.
    """
    scale = coordinates.unravel(first)

    def total(theta: Array) -> Array:
        p = scale(theta)
        return jnp.sum(jnp.exp(p["inertia"].at[coordinates.ends].add(-2 * p["rod_scale"])))

    slope = np.asarray(jax.grad(total)(jnp.asarray(theta, jnp.float32)), np.float64) @ free
    return np.linalg.svd(slope[None])[2][1:].T


def _prior(problem: Problem, theta: Vector) -> Vector:
    """`[p]` inverse variances before recordings are seen, by which a number that they do not tell is not known."""
    p = problem.named(theta)
    broad = {
        "inertia": UNKNOWN,
        "rod_scale": 0.5,
        "lean": LEAN,
        "level": 1.0,
        "potential": UNKNOWN * float(jnp.abs(p["potential"]).max(initial=0.1)),
    }
    if "spring" in p:
        broad["spring"] = UNKNOWN * float(jnp.abs(p["spring"]).max(initial=0.1))
    broad["input"] = broad["constant_input"] = UNKNOWN * float(
        max(jnp.abs(p[name]).max(initial=0.1) for name in ("input", "constant_input"))
    )
    return np.asarray(ravel_pytree({name: jnp.full_like(p[name], broad[name] ** -2) for name in p})[0], np.float64)


def _stored(coordinates: Coordinates, first: Variables, theta: Vector, root: Vector, sums: _Sums) -> Uncertainty:
    """In the model's own numbers."""

    def numbers(theta: Array) -> dict[str, Array]:
        found = coordinates.variables(first, theta)
        return numbers_of(found, found["rod_scale"], found["lean"])

    here = jnp.asarray(theta, jnp.float32)
    middle = numbers(here)
    steps = jax.vmap(lambda step: jax.jvp(numbers, (here,), (step,))[1])(jnp.asarray(root, jnp.float32))
    arrays = partial(jax.tree.map, np.asarray)
    return Uncertainty(arrays(middle), arrays(steps), sums.spread, sums.correlation)
