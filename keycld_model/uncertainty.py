"""How far the numbers that describe a mechanism may be off: a Gaussian around what was identified, of low rank."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from keycld_model.modules import Parameters, Parts

Floats = NDArray[np.float32]
NORMAL_90 = 1.6448536
"""Standard deviations on either side of the middle that hold 90 % of a normal distribution."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What identification found, with everything free that motion can tell, and how far it may be off.

    Numbers are by name: "log_masses" `[K + L]`, "level" `[c]`, the linear terms of V and g, "potential" `[n, 1]`,
    "input" `[n, n*m]` and "constant_input" `[n*m]`, springs along rails, if the model has some, "spring" `[S]`, and
    where masses lie beside the keypoints, "rod_scale" and "lean" `[K]`.

    Attributes:
        centre: the numbers, as arrays.
        deviations: by the same names, with a leading axis: independent standard deviations of all of them.
        spread: standard deviation of a keypoint's coordinate from its trajectory, image units.
        correlation: of that deviation from frame to frame.
    """

    centre: Mapping[str, Floats]
    deviations: Mapping[str, Floats]
    spread: float
    correlation: float

    def draw(self, count: int, rng: np.random.Generator) -> dict[str, Floats]:
        """Numbers as they may be, with a leading axis of `count`."""
        normal = rng.normal(size=(count, len(self.deviations["log_masses"]))).astype(np.float32)
        return {name: self.centre[name] + np.tensordot(normal, self.deviations[name], 1) for name in self.centre}

    def either_side(self) -> dict[str, Floats]:
        """The centre, then it plus every deviation, then minus, `[1 + 2r, ...]`."""
        return {
            name: np.concatenate([middle[None], middle + self.deviations[name], middle - self.deviations[name]])
            for name, middle in self.centre.items()
        }

    def keypoint_errors(self, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
        """Deviations `[..., C, n]` of keypoints from a trajectory, image units, as correlated as the measured ones."""
        white = rng.normal(size=shape)
        errors = white.copy()
        for t in range(1, shape[-2]):
            fresh = np.sqrt(1 - self.correlation**2) * white[..., t, :]
            errors[..., t, :] = self.correlation * errors[..., t - 1, :] + fresh
        return (self.spread * errors).astype(np.float32)

    def tensors(self) -> dict[str, Any]:
        """Arrays to store, the inverse of `from_tensors`."""
        noise = np.asarray([self.spread, self.correlation], np.float32)
        return {"centre": dict(self.centre), "deviations": dict(self.deviations), "noise": noise}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Any], parts: Parts) -> "Uncertainty":
        """What `tensors` gave.

        Raises:
            ValueError: if they are not those of a model.
        """
        asked = jax.eval_shape(lambda p: numbers_of(p, None, None), parts.shapes())
        shapes = {name: array.shape for name, array in asked.items()}
        centre, deviations = tensors["centre"], tensors["deviations"]
        if {name: array.shape for name, array in centre.items()} != shapes:
            raise ValueError("other numbers than the model has")
        if {name: array.shape[1:] for name, array in deviations.items()} != shapes:
            raise ValueError("other deviations than numbers")
        if len({len(array) for array in deviations.values()}) != 1:
            raise ValueError("deviations of different count")
        spread, correlation = map(float, tensors["noise"])
        return cls(dict(centre), dict(deviations), spread, correlation)


def numbers_of(parameters: Parameters, rod_scale: Any, lean: Any) -> dict[str, Any]:
    """The numbers of a model, or of training's variables, by the names of `Uncertainty`; JAX-traceable."""
    dynamics = parameters["dynamics"]
    potential = dynamics["potential"]["linear"]["kernel"]
    there = jnp.zeros(potential.shape[0] // 2)
    return {
        "log_masses": dynamics["log_masses"],
        "level": dynamics["level"],
        "potential": potential,
        **({"spring": dynamics["spring"]} if "spring" in dynamics else {}),
        "input": dynamics["input"]["linear"]["kernel"],
        "constant_input": dynamics["input"]["linear"]["bias"],
        "rod_scale": there if rod_scale is None else rod_scale,
        "lean": there if lean is None else lean,
    }


def with_numbers(parameters: Parameters, numbers: Mapping[str, Any]) -> Parameters:
    """The same model with other numbers; JAX-traceable. Its masses lie where `numbers` say, beside its keypoints."""
    dynamics = parameters["dynamics"]
    potential, force = dynamics["potential"], dynamics["input"]
    return {
        **parameters,
        "dynamics": {
            **dynamics,
            "log_masses": numbers["log_masses"],
            "level": numbers["level"],
            "potential": {**potential, "linear": {**potential["linear"], "kernel": numbers["potential"]}},
            **({"spring": numbers["spring"]} if "spring" in numbers else {}),
            "input": {**force, "linear": {"kernel": numbers["input"], "bias": numbers["constant_input"]}},
        },
    }
