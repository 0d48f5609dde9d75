"""One step of the optimiser, compiled."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import optax

from keycld_model.modules import Parts
from keycld_model.training.sharding import Devices
from keycld_model.training.stage import Batch, Stage, Variables


def make_step(
    parts: Parts, stage: Stage, optimiser: optax.GradientTransformation, devices: Devices | None = None
) -> Callable[..., Any]:
    """The pure step (trained, frozen, optimiser state, batch) -> (trained, optimiser state, metrics), compiled."""

    def loss(trained: Variables, frozen: Variables, batch: Batch) -> tuple[jax.Array, dict[str, jax.Array]]:
        return stage.loss(parts, {**frozen, **trained}, batch)

    everywhere = None if devices is None else devices.everywhere

    @partial(jax.jit, **({} if everywhere is None else {"out_shardings": everywhere}))
    def step(trained: Variables, frozen: Variables, state: Any, batch: Batch) -> tuple[Any, Any, dict[str, Any]]:
        (value, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(trained, frozen, batch)
        updates, state = optimiser.update(gradient, state, trained)
        return optax.apply_updates(trained, updates), state, {"loss": value, **metrics}

    return step
