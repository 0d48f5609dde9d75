"""What a world model has learned of a system: masses, lengths, energies, inputs, as pure functions."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_envs import system_of
from keycld_envs.effects import Effect
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_model.added_effects import AddedEffects, added_effects
from keycld_model.compiled import CompiledModel
from keycld_model.config import ModelConfig
from keycld_model.modules import Parameters, Parts
from keycld_model.uncertainty import Uncertainty

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class LearnedSystem:
    """Configuration and parameters, and what follows from them; see `WorldModel` for the units.

    Attributes:
        config: architecture, mechanism, seconds between frames, image size.
        parameters: nested dictionary of arrays.
        name: where the model came from: a shipped name or a path.
        meta: what the checkpoint says about its training.
        effects: physics beside what was learned, such as a diagnosis found; see `with_effects`.
        uncertainty: how far masses, lengths, V and g may be off, if that was measured.
    """

    config: ModelConfig
    parameters: Parameters
    name: str = "untitled"
    meta: dict[str, Any] | None = None
    effects: tuple[Effect, ...] = ()
    uncertainty: Uncertainty | None = None

    # What the model is of -------------------------------------------------------------------------------------------

    @property
    def system(self) -> str | None:
        """Environment id the model was trained on, or None."""
        return self.config.system

    @property
    def mechanism(self) -> Mechanism:
        """Keypoints, rods and sliders."""
        return self.config.mechanism

    @property
    def constrained(self) -> bool:
        """Rods and sliders hold the masses; in KeyCLD-NC and NODE2 nothing does."""
        return self.config.networks.motion == "constrained"

    @property
    def timestep(self) -> float:
        """Seconds between frames."""
        return self.config.timestep

    @property
    def image_shape(self) -> tuple[int, int]:
        """(H, W), pixels."""
        return self.config.image_shape

    @cached_property
    def masses(self) -> Floats:
        """[K] point masses of keypoints, fractions of the total; then [L] in the middle of rods between two joints."""
        return np.asarray(self.parts.lagrangian(self.parameters).masses)

    @cached_property
    def level(self) -> Floats:
        """[c] constants of the constraints: half squared rod lengths, slider offsets; image units."""
        return np.asarray(self.parameters["dynamics"]["level"])

    @cached_property
    def pivot(self) -> Floats:
        """[2] position of the fixed pivot, image units."""
        return np.asarray(self.parameters["dynamics"]["pivot"])

    # Pure functions of one frame or state, to be traced into larger programs ----------------------------------------

    @cached_property
    def _compiled(self) -> CompiledModel:
        return CompiledModel(self.config, self.added)

    @cached_property
    def added(self) -> AddedEffects | None:
        """The effects in the model's units, None if there are none."""
        if not self.effects:
            return None
        if self.system is None or not self.constrained:
            raise InputError(
                "Effects are added to a model of a registered system whose rods and sliders hold its masses."
            )
        lagrangian = Parts(self.config).lagrangian(self.parameters)
        return added_effects(
            self.effects,
            system_of(self.system),
            self.timestep,
            lagrangian.points,
            lagrangian.potential_energy,
            lagrangian.input_matrix,
        )

    @property
    def parts(self) -> Parts:
        """The modules, to be applied to `parameters`."""
        return self._compiled.parts

    def keypoints_fn(self, image: Array) -> Array:
        """Keypoints `[n]` of one image `[H, W, 3]`, uint8 or float in 0 to 1. JAX-traceable."""
        return self.parts.keypoints(self.parameters, image[None])[0]

    def potential_energy_fn(self, x: Array) -> Array:
        """V (scalar) of positions `[n]`. JAX-traceable."""
        potential = self.parts.lagrangian(self.parameters).potential_energy(x)
        return potential if self.added is None else potential + self.added.potential_energy(x)

    def input_matrix_fn(self, x: Array) -> Array:
        """g `[n, m]` of positions `[n]`. JAX-traceable."""
        return self.parts.lagrangian(self.parameters).input_matrix(x)

    def render_fn(self, x: Array) -> Array:
        """Image `[H, W, 3]` in 0 to 1 of positions `[n]`. JAX-traceable."""
        return self.parts.render(self.parameters, x[None])[0]
