"""The declaration of a planar mechanism: how many keypoints, and what holds them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from keycld_envs.errors import InputError


@dataclass(frozen=True)
class Rod:
    """A rigid rod of unknown length that ends in keypoint `end`.

    Attributes:
        start: index of the keypoint the rod starts at, or None for the mechanism's fixed pivot.
        end: index of the keypoint the rod ends at.
    """

    start: int | None
    end: int


@dataclass(frozen=True)
class Slider:
    """A straight rail through the pivot that carries keypoint `keypoint`.

    Attributes:
        keypoint: index of the keypoint on the rail.
        normal: direction in which the keypoint cannot move, image axes (x right, y up).
    """

    keypoint: int
    normal: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True)
class Mechanism:
    """Point masses in the image plane, held by rods and sliders (KeyCLD paper, Fig. 7).

    Lengths are unknown: only the derivatives of the constraints enter the equations of motion.

    Attributes:
        num_keypoints: K, the number of moving keypoints.
        num_actions: m, the number of actuators.
        rods: rigid rods between keypoints, or from the pivot.
        sliders: straight rails.
        pivot: position of the fixed pivot, image units (-1 to 1, y up).
    """

    num_keypoints: int
    num_actions: int
    rods: tuple[Rod, ...] = ()
    sliders: tuple[Slider, ...] = ()
    pivot: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for rod in self.rods:
            ends = [rod.end] if rod.start is None else [rod.start, rod.end]
            if not all(0 <= k < self.num_keypoints for k in ends):
                raise InputError(f"{rod} names a keypoint outside 0..{self.num_keypoints - 1}.")
        for slider in self.sliders:
            if not 0 <= slider.keypoint < self.num_keypoints:
                raise InputError(f"{slider} names a keypoint outside 0..{self.num_keypoints - 1}.")
        if self.degrees_of_freedom < 1:
            raise InputError(
                f"{len(self.rods) + len(self.sliders)} constraints on {self.num_keypoints} keypoints "
                "leave no degree of freedom; declare fewer rods or sliders."
            )

    @property
    def num_constraints(self) -> int:
        """c, the number of scalar holonomic constraints."""
        return len(self.rods) + len(self.sliders)

    @property
    def degrees_of_freedom(self) -> int:
        """2K minus the number of constraints."""
        return 2 * self.num_keypoints - self.num_constraints

    def to_dict(self) -> dict[str, Any]:
        """The declaration as JSON-compatible data, the inverse of `from_dict`."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Mechanism":
        """Read a declaration written by `to_dict`.

        Raises:
            InputError: if a field is missing or unknown.
        """
        try:
            return cls(
                num_keypoints=int(data["num_keypoints"]),
                num_actions=int(data["num_actions"]),
                rods=tuple(Rod(**rod) for rod in data["rods"]),
                sliders=tuple(
                    Slider(s["keypoint"], tuple(s["normal"]))  # pyright: ignore[reportArgumentType]
                    for s in data["sliders"]
                ),
                pivot=(float(data["pivot"][0]), float(data["pivot"][1])),
            )
        except (KeyError, TypeError) as error:
            raise InputError(f"The mechanism declaration is incomplete or has an unknown field: {error}.") from error
