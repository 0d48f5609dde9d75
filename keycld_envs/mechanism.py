"""The declaration of a planar mechanism: how many keypoints, and what holds them."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from keycld_envs.checks import check_whole, finite_vector, several
from keycld_envs.errors import InputError

MOST_KEYPOINTS = 64


@dataclass(frozen=True)
class Rod:
    """A rigid rod of unknown length that ends in keypoint `end`.

    Attributes:
        start: index of the keypoint the rod starts at, or None for the mechanism's fixed pivot.
        end: index of the keypoint the rod ends at.
    """

    start: int | None
    end: int

    def __post_init__(self) -> None:
        if self.start is not None:
            check_whole("start of a Rod", self.start, 0, MOST_KEYPOINTS - 1)
        check_whole("end of a Rod", self.end, 0, MOST_KEYPOINTS - 1)
        if self.start == self.end:
            raise InputError(f"{self} ends where it starts; name two keypoints, or None for the pivot.")


@dataclass(frozen=True)
class Slider:
    """A straight rail through the pivot that carries keypoint `keypoint`.

    Attributes:
        keypoint: index of the keypoint on the rail.
        normal: direction in which the keypoint cannot move, image axes (x right, y up).
    """

    keypoint: int
    normal: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        check_whole("keypoint of a Slider", self.keypoint, 0, MOST_KEYPOINTS - 1)
        if not finite_vector("normal of a Slider", self.normal, 2).any():
            raise InputError(f"{self} has a normal without direction; for a level rail it is (0.0, 1.0).")
        object.__setattr__(self, "normal", tuple(self.normal))

    @property
    def along(self) -> tuple[float, float]:
        """Unit vector of the rail; to the right, if the normal points up."""
        x, y = self.normal
        length = math.hypot(x, y)
        return y / length, -x / length


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
        check_whole("num_keypoints", self.num_keypoints, 1, MOST_KEYPOINTS)
        check_whole("num_actions", self.num_actions, 0, MOST_KEYPOINTS)
        for name, kind in (("rods", Rod), ("sliders", Slider)):
            object.__setattr__(self, name, several(name, getattr(self, name), kind))
        finite_vector("pivot", self.pivot, 2)
        object.__setattr__(self, "pivot", tuple(self.pivot))
        pairs = [frozenset((rod.start, rod.end)) for rod in self.rods]
        if twice := [rod for rod, pair in zip(self.rods, pairs, strict=True) if pairs.count(pair) > 1]:
            raise InputError(f"{twice[0]} is declared twice; keep one of them.")
        for rod in self.rods:
            ends = [rod.end] if rod.start is None else [rod.start, rod.end]
            if not all(0 <= k < self.num_keypoints for k in ends):
                raise InputError(
                    f"{rod} names a keypoint outside 0..{self.num_keypoints - 1}; correct it, or num_keypoints."
                )
        for slider in self.sliders:
            if not 0 <= slider.keypoint < self.num_keypoints:
                raise InputError(
                    f"{slider} names a keypoint outside 0..{self.num_keypoints - 1}; correct it, or num_keypoints."
                )
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
