"""How often 90 % intervals of masses, lengths, V and g hold what is true."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from keycld_control.benchmarks.figure import Figure
from keycld_control.benchmarks.intervals.keypoints import Errors, near_truth, simulate
from keycld_control.benchmarks.intervals.mechanisms import KINDS, Kind, drawn_mechanism
from keycld_control.benchmarks.intervals.truth import Truth, truth_of
from keycld_control.benchmarks.weights import Weights
from keycld_envs.progress import progress
from keycld_envs.systems import get_system
from keycld_model import WorldModel
from keycld_model.places import to_keypoints
from keycld_model.training.covariance import measure_uncertainty

Array = NDArray[np.floating]
RECORDINGS, FRAMES = 40, 50
POSES = 4
"""At which V and g are compared."""
SMALL = 0.05
"""Components of g below this share of its largest are not counted: most are zero by the mechanism's geometry."""
LEAST, MOST = 0.85, 0.95
"""Coverage that 90 % intervals must have."""


@dataclass(frozen=True)
class Compared:
    """Intervals of one mechanism beside the truth.

    Attributes:
        truth: `[i]` numbers of each quantity, by name.
        intervals: `[i, 2]`.
    """

    truth: dict[str, Array]
    intervals: dict[str, Array]

    @property
    def inside(self) -> dict[str, NDArray[np.bool_]]:
        """Whether each interval holds the truth."""
        return {
            name: (self.intervals[name][:, 0] <= true) & (true <= self.intervals[name][:, 1])
            for name, true in self.truth.items()
        }


def compare(model: WorldModel, truth: Truth, seed: int) -> Compared:
    """Intervals of a model beside what is true of the mechanism.

    Its estimator may see an end of a rod beside the mass, so V and g are asked for where it sees the true positions.
    Nothing tells where on its rod the only mass of a pendulum is, so its own length is the unit there.

    Args:
        model: with uncertainties.
        truth: of the mechanism that it has learned.
        seed: of the poses at which V and g are compared.
    """
    mechanism, uncertainty = model.mechanism, model.uncertainty
    assert uncertainty is not None
    lengths = np.sqrt(2 * uncertainty.centre["level"][: len(mechanism.rods)])
    alone = mechanism.num_keypoints == 1
    unit = float(lengths[0] / truth.lengths[0]) if alone else 1.0
    scale = np.zeros(mechanism.num_keypoints)
    if not alone:
        ends = [rod.end for rod in mechanism.rods]
        scale[ends] = uncertainty.centre["rod_scale"][ends] + np.log(truth.lengths / lengths)
    qpos = np.random.default_rng((seed, 1)).uniform(-2, 2, (POSES, truth.model.nq))
    x = truth.positions(qpos)
    there = {"rod_scale": scale, "lean": uncertainty.centre["lean"]}
    at = np.asarray(to_keypoints(mechanism, there, jnp.asarray(x.reshape(POSES, -1) * unit)))
    found = model.intervals(at=at.reshape(x.shape))
    energy, force = truth.potential_energy(x) * unit**2, truth.forces(qpos) * unit
    counted = np.abs(force) > SMALL * np.abs(force).max()
    assert found.potential_energy is not None and found.input_matrix is not None
    true = {"V": energy[1:] - energy[0], "g": force[counted]}
    intervals = {"V": found.potential_energy[1:], "g": found.input_matrix[counted]}
    if not alone:
        true |= {"masses": truth.masses[-1:], "lengths": truth.lengths}
        intervals |= {"masses": found.masses[-1:], "lengths": found.lengths}
    return Compared(true, {name: np.asarray(value, np.float64) for name, value in intervals.items()})


def compare_drawn(kind: Kind, seed: int) -> Compared:
    """Of a drawn mechanism, from keypoints with an estimator's errors.

    Args:
        kind: of mechanism.
        seed: of the mechanism, its motions, errors, and where identification starts.
    """
    truth, rng = truth_of(drawn_mechanism(kind, seed)), np.random.default_rng((seed, 7))
    motion = simulate(truth, RECORDINGS, FRAMES, rng)
    x = truth.positions(motion.qpos)
    exact = x.reshape(RECORDINGS, FRAMES, -1)
    keypoints = (exact + Errors().draw(truth, x, rng)).astype(np.float32)
    parts, variables = near_truth(truth, rng)
    start = exact[:, 0].astype(np.float32)
    variables["trajectories"] = {"x": jnp.asarray(start), "v": jnp.zeros_like(start)}
    uncertainty = measure_uncertainty(parts, variables, keypoints, motion.actions.astype(np.float32))
    parameters = {**jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), parts.shapes()), **variables}
    return compare(WorldModel(parts.config, parameters, uncertainty=uncertainty), truth, seed)


def interval_figures(mechanisms: int, seed: int, kinds: Sequence[Kind] = KINDS) -> Iterator[Figure]:
    """Coverage of 90 % intervals over drawn mechanisms, kind by kind in turn.

    Args:
        mechanisms: how many in all.
        seed: of the first of each kind.
        kinds: of mechanisms.
    """
    found = []
    with progress("Mechanisms", total=mechanisms) as advance:
        for i in range(mechanisms):
            kind = kinds[i % len(kinds)]
            found.append((kind, compare_drawn(kind, seed + i // len(kinds)).inside))
            advance()
    for name in ("masses", "lengths", "V", "g"):
        each = [inside[name] for _, inside in found if name in inside]
        yield coverage(f"coverage of 90 % intervals, {name}", each, seed)
    yield coverage("coverage of 90 % intervals, all", [np.concatenate(list(i.values())) for _, i in found], seed)


def trained_figures(weights: Weights, seed: int) -> Iterator[Figure]:
    """Of models that were trained from pixels: how many of their intervals hold what is true.

    Args:
        weights: of the reference systems.
        seed: of the poses at which V and g are compared.
    """
    measure = "90 % intervals that hold the truth, of weights"
    for system in weights.systems:
        model = WorldModel.load(weights.source(system))
        if model.uncertainty is None:
            reason = "Weights without uncertainties get them with `keycld intervals CHECKPOINT --data DATA --out OUT`."
            yield Figure(measure=measure, system=system, reached=None, details={"reason": reason})
            continue
        inside = compare(model, truth_of(get_system(system)), seed).inside
        share = float(np.concatenate(list(inside.values())).mean())
        counts = {name: [int(i.sum()), len(i)] for name, i in inside.items()}
        yield Figure(measure=measure, system=system, reached=share, count=1, details=counts)


def coverage(measure: str, each: Sequence[NDArray[np.bool_]], seed: int) -> Figure:
    """Share of intervals that hold the truth, with its interval over mechanisms.

    Args:
        measure: in words.
        each: of every mechanism, whether its intervals do.
        seed: of the first mechanism.
    """

    def share(inside: Array, counted: Array, axis: int = -1) -> Array:
        return inside.sum(axis=axis) / counted.sum(axis=axis)

    inside, counted = (np.array([f(i) for i in each], float) for f in (np.sum, len))
    reached = float(share(inside, counted))
    interval = None
    if len(each) > 1 and np.ptp(inside / counted) > 0:
        spread = bootstrap(
            (inside, counted), share, paired=True, method="percentile", vectorized=True, rng=np.random.default_rng(0)
        ).confidence_interval
        interval = float(spread.low), float(spread.high)
    wide = reached > MOST
    return Figure(
        measure=measure,
        system="drawn",
        reached=reached,
        required=MOST if wide else LEAST,
        at_most=wide,
        interval=interval,
        count=len(each),
        details={"intervals": int(counted.sum()), "aim": [LEAST, MOST], "seed": seed},
    )
