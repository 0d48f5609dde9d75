"""What a configuration compiles to, for any parameters and any number of images or positions."""

from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import Any

import jax
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from keycld_model.added_effects import AddedEffects
from keycld_model.config import ModelConfig
from keycld_model.dynamics import Dynamics
from keycld_model.dynamics_with_effects import DynamicsWithEffects
from keycld_model.modules import Parameters, Parts, as_float
from keycld_model.places import to_keypoints, to_masses
from keycld_model.state_estimation import estimate_state, refine_state
from keycld_model.uncertainty import with_numbers

Floats = NDArray[np.float32]


class CompiledModel:
    """Functions that are compiled at their first call, and shared by all parameters of a configuration.

    Args:
        config: the architecture.
        added: effects beside it, for one set of parameters.
    """

    def __init__(self, config: ModelConfig, added: AddedEffects | None = None) -> None:
        self.parts, self.added = Parts(config), added

    def keypoints(self, parameters: Parameters, images: NDArray[Any]) -> Floats:
        """Keypoints [..., K, 2] of images [..., H, W, 3], uint8 or float in 0 to 1."""
        flat = _in_chunks(partial(self._keypoints, parameters), images.reshape(-1, *images.shape[-3:]))
        return flat.reshape(*images.shape[:-3], self.parts.config.mechanism.num_keypoints, 2)

    def of_keypoints(self, name: str, parameters: Parameters, x: Floats) -> Floats:
        """What depends on keypoints [..., K, 2]: V, g, the constraint, or the image.

        Args:
            name: "potential_energy", "input_matrix", "constraint" or "render".
            parameters: of the model.
            x: keypoints, image units.
        """
        function = partial(self._of_positions[name], parameters)
        flat = _in_chunks(function, x.reshape(-1, 2 * x.shape[-2]))
        return flat.reshape(x.shape[:-2] + flat.shape[1:])

    def rollout(
        self, parameters: Parameters, frames: NDArray[Any], actions: Floats, refine: bool
    ) -> tuple[Array, Array]:
        """Positions and velocities `[T, n]` from the first frames `[C, H, W, 3]` and all actions `[T-1, m]`.

        Args:
            parameters: of the model.
            frames: from which the first state is estimated.
            actions: between frames.
            refine: fit the state to the pixels, not only to the keypoints.
        """
        return self._rollouts[refine](parameters, frames, actions)

    def sampled(
        self,
        parameters: Parameters,
        numbers: Mapping[str, Floats],
        state: tuple[Floats, Floats],
        seen: Floats,
        u: Floats,
    ) -> Floats:
        """Keypoints `[samples, T, n]` of rollouts with other masses, lengths and forces, from other first keypoints.

        Args:
            parameters: of the model.
            numbers: see `keycld_model.uncertainty.Uncertainty`, with a leading axis of samples.
            state: keypoints and velocities `[n]` at the first frame, near which theirs are.
            seen: `[samples, C, n]` keypoints in the first C frames, image units.
            u: `[T-1, m]` actions.
        """
        return np.asarray(self._sampled(parameters, dict(numbers), state, seen, u))

    @cached_property
    def _sampled(self) -> Callable[..., Array]:
        mechanism, h = self.parts.config.mechanism, self.parts.config.timestep

        def one(parameters: Parameters, numbers: dict[str, Array], state: Any, seen: Array, u: Array) -> Array:
            dynamics = self._dynamics(with_numbers(parameters, numbers))
            *start, masses = (to_masses(mechanism, numbers, x) for x in (*state, seen))
            first = estimate_state(dynamics, masses, u[: len(seen) - 1], h, start=(start[0], start[1]), fine=True)
            return to_keypoints(mechanism, numbers, dynamics.rollout(*first, u, h, fine=True)[0])

        return jax.jit(jax.vmap(one, (None, 0, None, 0, None)))

    @cached_property
    def _keypoints(self) -> Callable[[Parameters, NDArray[Any]], Array]:
        return jax.jit(self.parts.keypoints)

    @cached_property
    def _of_positions(self) -> dict[str, Callable[[Parameters, ArrayLike], Array]]:
        of, lagrangian = self.parts.dynamics, self.parts.lagrangian
        functions = {
            "potential_energy": lambda p, x: jax.vmap(self._potential_energy(p))(x),
            "input_matrix": lambda p, x: jax.vmap(lagrangian(p).input_matrix)(x),
            "constraint": lambda p, x: jax.vmap(of(p).constraint)(x) - p["dynamics"]["level"],
            "render": self.parts.render,
        }
        return {name: jax.jit(function) for name, function in functions.items()}

    @cached_property
    def _rollouts(self) -> dict[bool, Callable[[Parameters, ArrayLike, ArrayLike], tuple[Array, Array]]]:
        h = self.parts.config.timestep

        def one(parameters: Parameters, frames: Array, u: Array, refine: bool) -> tuple[Array, Array]:
            dynamics, first = self._dynamics(parameters), u[: frames.shape[0] - 1]
            keypoints = self.parts.keypoints(parameters, frames)
            state = estimate_state(dynamics, keypoints, first, h, fine=True)
            if refine:
                draw = partial(self.parts.fine_render, parameters)
                state = refine_state(dynamics, draw, as_float(frames), keypoints, first, h, state)
            return dynamics.rollout(*state, u, h, fine=True)

        return {refine: jax.jit(partial(one, refine=refine)) for refine in (False, True)}

    def _dynamics(self, parameters: Parameters) -> Dynamics:
        if self.added is None:
            return self.parts.dynamics(parameters)
        return DynamicsWithEffects(self.parts.lagrangian(parameters), self.added)

    def _potential_energy(self, parameters: Parameters) -> Callable[[Array], Array]:
        learned, added = self.parts.lagrangian(parameters).potential_energy, self.added
        return learned if added is None else lambda x: learned(x) + added.potential_energy(x)


def _in_chunks(function: Callable[[NDArray[Any]], Array], array: NDArray[Any], chunk: int = 64) -> Floats:
    """Apply a function of a batch to a bounded number of rows at a time; none are allowed."""
    if len(array) == 0:
        return np.asarray(function(np.zeros((1, *array.shape[1:]), array.dtype)))[:0]
    return np.concatenate([np.asarray(function(array[i : i + chunk])) for i in range(0, len(array), chunk)])
