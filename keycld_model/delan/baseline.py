"""The least-squares baseline as a joint model, and what it says about a network."""

import jax
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_model.delan.config import FRICTIONS, JointConfig
from keycld_model.delan.families import JointDynamics
from keycld_model.delan.least_squares import chosen_cutoff, fit_least_squares, regressors
from keycld_model.delan.measures import Scores
from keycld_model.delan.model import JointModel
from keycld_model.delan.motions import CUTS, Motions
from keycld_model.delan.weights import torque_weights

FOLDS = 5
"""Of motions, or of tenths of motions where there are fewer, in turn."""
EXACT = 1e-12
"""Error as a share of the torques' variance below which only rounding is left."""
BETTER = 0.9
"""Share of the other's error below which one of both is better: errors of one family differ as much between seeds."""


def fit_baseline(motions: Motions, friction: tuple[str, ...] = ()) -> JointModel:
    """Base parameters by linear least squares, with the same weights of torques as networks have.

    Combinations of them that motions tell too badly stay zero; how badly is too badly is cross-validated.

    Args:
        motions: to learn from.
        friction: ids of effects at every joint; Stribeck friction counts as Coulomb friction.

    Raises:
        InputError: if the motions are too few.
    """
    if unknown := [id for id in friction if id not in FRICTIONS]:
        raise InputError(f"friction names {unknown[0]!r}; there are {', '.join(FRICTIONS)}.")
    config = JointConfig(motions.joints, motions.kinds, motions.scales(), "least_squares", friction=friction)
    q, v, a, tau = (motions.all(name) for name in ("q", "v", "a", "tau"))
    weight = 1 / np.array(config.scales.torque)
    weights = np.broadcast_to(weight, q.shape)
    with jax.enable_x64(True):
        rows = regressors(config, q, v, a)
        cutoff = chosen_cutoff(rows, tau, weight, _folds(motions))
        p = fit_least_squares(config, rows, tau, weights, cutoff)
        std = motions.all("v_std"), motions.all("a_std")
        if std[1].any():
            weights = weights * torque_weights(JointDynamics(config), p, (q, v, a, tau), std)
            p = fit_least_squares(config, rows, tau, weights, cutoff)
    return JointModel(config, p, {"cutoff": cutoff})


def _folds(motions: Motions) -> NDArray[np.int_]:
    """Of each sample `[N]`: motions in turn, or, where there are fewer, tenths of them."""
    lengths = [len(motion.t) for motion in motions.motions]
    if len(lengths) >= FOLDS:
        return np.repeat(np.arange(len(lengths)) % FOLDS, lengths)
    return np.concatenate([CUTS * np.arange(length) // length % FOLDS for length in lengths])


def verdict(network: Scores, baseline: Scores) -> str:
    """One sentence on whether a network is worth its while on these motions."""
    ours, theirs = network.torque_share, baseline.torque_share
    errors = f"errors of torques over their variance: network {ours:.2g}, least squares {theirs:.2g}"
    if baseline.indefinite:
        errors += f"; inertias of the latter are not positive at {baseline.indefinite:.0%} of the samples"
    if theirs < EXACT:
        return f"Least squares of base parameters is exact here, so these data need no network ({errors})."
    if theirs < BETTER * ours:
        return f"Least squares of base parameters is better, so these data need no network ({errors})."
    if ours < BETTER * theirs:
        return f"The network is better than least squares of base parameters ({errors})."
    return f"The network is as good as least squares of base parameters ({errors})."
