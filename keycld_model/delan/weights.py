"""How much each torque counts: the uncertainty of velocities and accelerations as one of torques."""

import jax
import jax.numpy as jnp
import numpy as np

from keycld_model.delan.families import JointDynamics
from keycld_model.delan.motions import Floats
from keycld_model.delan.network import Parameters

FLOOR = 0.1
"""Share of the mean propagated variance that is added at least: no sample counts beyond all others."""


def torque_weights(
    dynamics: JointDynamics, p: Parameters, samples: tuple[Floats, ...], std: tuple[Floats, Floats]
) -> Floats:
    """One over the standard deviation of each torque's error, `[N, n]`, in units of the mean one.

    To first order, var(tau) = s^2 + (dtau/dv)^2 var(v) + (dtau/da)^2 var(a), where s^2 is what the errors of a first
    model have beyond that on average.

    Args:
        dynamics: the family.
        p: parameters of the first model.
        samples: q, v, a and tau, `[N, n]` each.
        std: of v and of a, `[N, n]` each.
    """
    q, v, a, tau = samples
    with jax.enable_x64(True):
        p = jax.tree.map(jnp.asarray, p)
        slopes = jax.jit(jax.vmap(jax.jacfwd(lambda q, v, a: dynamics.inverse_dynamics(p, q, v, a), (1, 2))))(q, v, a)
        torque = jax.jit(jax.vmap(lambda q, v, a: dynamics.inverse_dynamics(p, q, v, a)))(q, v, a)
    by_v, by_a = map(np.asarray, slopes)
    propagated = np.einsum("tij,tj->ti", by_v**2, std[0] ** 2) + np.einsum("tij,tj->ti", by_a**2, std[1] ** 2)
    mean = propagated.mean(axis=0)
    rest = np.maximum(np.mean((np.asarray(torque) - tau) ** 2, axis=0) - mean, FLOOR * mean)
    return np.sqrt((rest + mean) / (rest + propagated))


def repeated(dynamics: JointDynamics, p: Parameters, samples: tuple[Floats, ...]) -> float:
    """How many neighbouring torques have the same error, mean of the joints.

    One plus twice the sum of the errors' autocorrelations, up to the first that is not positive (Geyer, 1992).
    """
    q, v, a, tau = samples
    with jax.enable_x64(True):
        p = jax.tree.map(jnp.asarray, p)
        torque = jax.jit(jax.vmap(lambda q, v, a: dynamics.inverse_dynamics(p, q, v, a)))(q, v, a)
    return float(np.mean([_correlation_time(error) for error in (np.asarray(torque) - tau).T]))


def _correlation_time(error: Floats) -> float:
    error = error - error.mean()
    power = np.abs(np.fft.rfft(error, 2 * len(error))) ** 2
    correlation = np.fft.irfft(power)[: len(error)]
    if correlation[0] == 0:
        return 1.0
    correlation = correlation / correlation[0]
    end = int(np.argmax(correlation <= 0)) or len(correlation)
    return float(1 + 2 * np.sum(correlation[1:end]))
