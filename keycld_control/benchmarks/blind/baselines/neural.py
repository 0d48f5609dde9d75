"""A small network for the missing torque, fitted to residual accelerations; it names nothing."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import optax
from numpy.typing import NDArray

from keycld_control.benchmarks.blind.baselines.common import EXPLAINED, Setup, with_effects
from keycld_control.benchmarks.blind.baselines.residual import Array, Law, LearntTorque, missing_torque
from keycld_control.benchmarks.refitting import minimise
from keycld_envs.recordings import Recording

WIDTH, STEPS, EVERY = 32, 2000, 50
"""Units per layer, steps, and steps between looks at the recordings that stop the training early."""
VALIDATION = 4
"""One in so many recordings stops the training early."""
Values = TypeVar("Values", jax.Array, Array)
Layers = list[tuple[Any, Any]]
"""Matrix and offset of each layer, arrays of JAX or of NumPy."""


def neural(training: Sequence[Recording], held_out: Sequence[Recording], model: mujoco.MjModel) -> dict[str, Any]:
    """Two hidden layers of positions (sines and cosines of angles), speeds and commands; early stopping."""
    setup = Setup.of(training, held_out, model)
    runs = [missing_torque(setup, r) for r in setup.training]
    slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    inputs = [_inputs(r.q, r.v, r.u, slides) for r in runs]
    law = _train(inputs, [r.torque for r in runs], slides)
    corrected = with_effects(setup.refitted.point.variant, LearntTorque.of(law, runs))
    fit = setup.refitted
    verdict = "undetermined" if fit.chi_square > EXPLAINED else "no_mismatch"
    after = minimise(fit.problem, fit.point.with_effects(*corrected.effects), 4, only_states=True)
    return setup.report(verdict, [], corrected, after.chi_square) | {
        "unexplained": {"significant": fit.chi_square > EXPLAINED}
    }


def _inputs(q: Array, v: Array, u: Array, slides: NDArray[np.bool_]) -> Array:
    """Inputs of the network, `[..., features]`."""
    return np.concatenate([np.sin(q[..., ~slides]), np.cos(q[..., ~slides]), q[..., slides], v, u], axis=-1)


def _train(inputs: Sequence[Array], torques: Sequence[Array], slides: NDArray[np.bool_]) -> Law:
    """The law of a network that is trained until it gets worse on every fourth recording."""
    kept = [i for i in range(len(inputs)) if i % VALIDATION]
    x, y = (np.concatenate([part[i] for i in kept]) for part in (inputs, torques))
    x_test, y_test = (np.concatenate(part[::VALIDATION]) for part in (inputs, torques))
    mean, size, scale = x.mean(axis=0), x.std(axis=0) + 1e-6, y.std(axis=0) + 1e-9
    sizes = [x.shape[1], WIDTH, WIDTH, y.shape[1]]
    keys = jax.random.split(jax.random.key(0), len(sizes) - 1)
    layers: Layers = [
        (jax.random.normal(k, (a, b)) / np.sqrt(a), jnp.zeros(b))
        for k, a, b in zip(keys, sizes, sizes[1:], strict=False)
    ]
    optimiser = optax.adam(optax.cosine_decay_schedule(3e-3, STEPS))

    def loss(layers: Layers, x: jax.Array, y: jax.Array) -> jax.Array:
        return jnp.mean((_network(layers, x, jnp) - y) ** 2)

    @jax.jit
    def step(layers: Layers, state: optax.OptState, x: jax.Array, y: jax.Array) -> tuple[Layers, optax.OptState]:
        updates, state = optimiser.update(jax.grad(loss)(layers, x, y), state)
        return cast(Layers, optax.apply_updates(layers, updates)), state

    arrays = [
        jnp.asarray(z, jnp.float32) for z in ((x - mean) / size, y / scale, (x_test - mean) / size, y_test / scale)
    ]
    state, best, chosen = optimiser.init(layers), float(jnp.mean(arrays[3] ** 2)), None
    for k in range(STEPS):
        layers, state = step(layers, state, arrays[0], arrays[1])
        if k % EVERY == 0 and (error := float(loss(layers, arrays[2], arrays[3]))) < best:
            best, chosen = error, jax.tree.map(np.asarray, layers)

    def law(q: Array, v: Array, u: Array) -> Array:
        if chosen is None:
            return np.zeros_like(v)
        return np.asarray(_network(chosen, (_inputs(q, v, u, slides) - mean) / size, np) * scale, np.float64)

    return law


def _network(layers: Layers, x: Values, numpy: ModuleType) -> Values:
    """The network's outputs, with the functions of NumPy or of JAX."""
    for matrix, offset in layers[:-1]:
        x = numpy.tanh(x @ matrix + offset)
    matrix, offset = layers[-1]
    return x @ matrix + offset
