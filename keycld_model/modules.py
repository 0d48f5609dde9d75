"""The networks and dynamics of a configuration, as functions of plain parameter dictionaries.

Parameters are plain nested dictionaries of arrays, not NNX states: each `nnx.Variable` costs host time at every
dispatch, and dictionaries go to the optimiser and into safetensors as they are.
"""

from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jax import Array

from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_model.acceleration_network import AccelerationNetwork
from keycld_model.config import ModelConfig, NetworkConfig
from keycld_model.dynamics import Dynamics
from keycld_model.lagrangian import Lagrangian
from keycld_model.nets import (
    FullyConnectedEstimator,
    FullyConnectedRenderer,
    KeypointEstimator,
    Renderer,
    RigidParts,
    rigid_parts,
)

Parameters = dict[str, Any]
"""{"estimator": …, "renderer": …, "dynamics": …, "appearance": …}, nested dictionaries of arrays."""
HIDDEN = (48, 32)
"""Widths of the two hidden layers of what draws a rigid part."""


class Parts:
    """Keypoint estimator, renderer and dynamics of one configuration.

    Args:
        config: the architecture.
    """

    def __init__(self, config: ModelConfig) -> None:
        self.config = config

    def _build(self, seed: int) -> dict[str, nnx.Module]:
        net, mechanism, rngs = self.config.networks, self.config.mechanism, nnx.Rngs(seed)
        image_networks = _hourglasses if net.images == "convolutional" else _fully_connected
        estimator, renderer = image_networks(mechanism, self.config.image_shape, net, rngs)
        built = {"estimator": estimator, "renderer": renderer, "dynamics": _dynamics(mechanism, net, rngs)}
        if net.rigid_parts:
            built["appearance"] = RigidParts(rigid_parts(mechanism), self.config.image_shape, HIDDEN, rngs)
        return built

    @cached_property
    def _graphs(self) -> dict[str, nnx.GraphDef[Any]]:
        modules = nnx.eval_shape(lambda: self._build(0))  # drawing initial weights takes seconds
        return {name: nnx.graphdef(module) for name, module in modules.items()}

    def initial(self, seed: int) -> Parameters:
        """Fresh parameters."""
        return _arrays(self._build(seed))

    def shapes(self) -> Parameters:
        """Parameters with arrays replaced by their shapes and types."""
        return jax.eval_shape(lambda: _arrays(self._build(0)))

    def _module(self, name: str, parameters: Parameters) -> Any:
        return nnx.merge(self._graphs[name], nnx.State(parameters[name]))

    def dynamics(self, parameters: Parameters) -> Dynamics:
        """The dynamics with these parameters."""
        return self._module("dynamics", parameters)

    def lagrangian(self, parameters: Parameters) -> Lagrangian:
        """The same, where masses, V and g are asked for.

        Raises:
            InputError: if the model has none.
        """
        dynamics = self.dynamics(parameters)
        if not isinstance(dynamics, Lagrangian):
            raise InputError(
                "This model has a network for the acceleration, so no masses, V or g; train one with "
                'motion="constrained".'
            )
        return dynamics

    def appearance(self, parameters: Parameters) -> RigidParts:
        """What the rigid parts look like, of a configuration with `rigid_parts`."""
        return self._module("appearance", parameters)

    def keypoints(self, parameters: Parameters, images: Array) -> Array:
        """Keypoints `[B, n]` of images `[B, H, W, 3]`, uint8 or float in 0 to 1."""
        keypoints = self._module("estimator", parameters)(as_float(images))
        return keypoints.reshape(keypoints.shape[0], -1)

    def render(self, parameters: Parameters, x: Array) -> Array:
        """Images `[B, H, W, 3]` of positions `[B, n]`."""
        pivot = parameters["dynamics"]["pivot"]
        return self._module("renderer", parameters)(x.reshape(x.shape[0], -1, 2), pivot)

    def fine_render(self, parameters: Parameters, x: Array) -> Array:
        """Images `[B, H, W, 3]` of positions `[B, n]`, as exact in where things are as the model can."""
        if not self.config.networks.rigid_parts:
            return self.render(parameters, x)
        return self.appearance(parameters)(x.reshape(x.shape[0], -1, 2), parameters["dynamics"]["pivot"])


def _hourglasses(
    mechanism: Mechanism, shape: tuple[int, int], net: NetworkConfig, rngs: nnx.Rngs
) -> tuple[nnx.Module, nnx.Module]:
    k = mechanism.num_keypoints
    segments = tuple((rod.start, rod.end) for rod in mechanism.rods) if net.segment_widths else ()
    constants = net.width - k if net.constants is None else net.constants
    return KeypointEstimator(k, shape, net.width, net.groups, net.folding, net.saliency, rngs), Renderer(
        k,
        segments,
        shape,
        net.width,
        net.groups,
        net.folding,
        constants,
        net.gaussian_widths,
        net.segment_widths,
        net.background,
        rngs,
    )


def _fully_connected(
    mechanism: Mechanism, shape: tuple[int, int], net: NetworkConfig, rngs: nnx.Rngs
) -> tuple[nnx.Module, nnx.Module]:
    k, width, groups, folding = mechanism.num_keypoints, net.width, net.groups, net.folding
    return (
        FullyConnectedEstimator(k, shape, width, groups, folding, net.saliency > 0, rngs),
        FullyConnectedRenderer(k, shape, width, groups, folding, net.background, rngs),
    )


def _dynamics(mechanism: Mechanism, net: NetworkConfig, rngs: nnx.Rngs) -> Dynamics:
    if net.motion == "acceleration":
        return AccelerationNetwork(mechanism, net.hidden, net.force_scale, net.kernel_scale, rngs)
    constrained = net.motion == "constrained"
    springs = net.identifiable and net.springs
    scales = net.force_scale, net.kernel_scale
    return Lagrangian(mechanism, net.hidden, *scales, net.linear, rngs, constrained, springs, net.rod_masses)


def _arrays(modules: dict[str, nnx.Module]) -> Parameters:
    return {name: nnx.to_pure_dict(nnx.state(module)) for name, module in modules.items()}


def as_float(images: Array) -> Array:
    """uint8 levels as floats in 0 to 1; floats as they are."""
    return images.astype(jnp.float32) / 255.0 if images.dtype == jnp.uint8 else images
