"""Energy that integrators invent or lose, and how far they leave the constraints."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from keycld_envs.recordings import Dataset
from keycld_model import WorldModel
from keycld_model.physics import INTEGRATORS, Integrator, in_parts, kinetic_energy
from keycld_model.world_model import CONTEXT_FRAMES

STEPS = 1000
STARTS = 10
METHODS: dict[str, Integrator] = {
    **INTEGRATORS,
    **{f"{name}, 4 per frame": in_parts(INTEGRATORS[name], 4) for name in ("projected", "rattle")},
}


def drift(model: WorldModel, test: Dataset) -> dict[str, Any]:
    """Of the learned energy, without actions, from states of recordings, over a thousand steps.

    The change is the largest deviation from the energy after the first step, relative to the range of V along the way;
    the drift compares means over the first and the last tenth, in which what only oscillates cancels.
    """
    stacked = test.sequences()
    frames = stacked.frames[:STARTS, :CONTEXT_FRAMES]
    positions, velocities = model.rollout(frames, stacked.actions[:STARTS, : CONTEXT_FRAMES - 1])
    count = len(positions)
    x, v = (jnp.asarray(a[:, 0].reshape(count, -1)) for a in (positions, velocities))
    dynamics, u = model.parts.lagrangian(model.parameters), jnp.zeros(model.mechanism.num_actions)
    out = {}
    for name, integrator in METHODS.items():

        @jax.jit
        def run(x: jax.Array, v: jax.Array, integrator: Integrator = integrator) -> tuple[jax.Array, ...]:
            step = partial(dynamics.step, u=u, step_size=model.timestep, integrator=integrator)

            def advance(state: tuple[jax.Array, jax.Array], _: None) -> tuple[Any, Any]:
                new = step(*state)
                potential = dynamics.potential_energy(new[0])
                off = jnp.max(jnp.abs(dynamics.constraint(new[0]) - dynamics.level[...]))
                return new, (kinetic_energy(dynamics.held, dynamics.masses, new[1]) + potential, potential, off)

            return jax.lax.scan(advance, dynamics.project(x, v), length=STEPS)[1]

        energy, potential, off = (np.asarray(a, np.float64) for a in jax.vmap(run)(x, v))
        size, tenth = np.ptp(potential, axis=1), STEPS // 10
        change = np.abs(energy - energy[:, :1]).max(axis=1) / size
        drifted = np.abs(energy[:, -tenth:].mean(axis=1) - energy[:, :tenth].mean(axis=1)) / size
        out[name] = {
            "change": np.nan_to_num(change, nan=np.inf).tolist(),
            "drift": np.nan_to_num(drifted, nan=np.inf).tolist(),
            "off_constraints": float(np.median(np.nan_to_num(off, nan=np.inf))),
        }
    return out
