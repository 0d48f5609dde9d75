"""What a joint model is made of, as frozen dataclasses. One field changed is one ablation."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, get_args

from keycld_envs.checks import check_choice, check_number, check_whole
from keycld_envs.errors import InputError

Family = Literal["structured", "black_box", "hamiltonian", "feed_forward", "least_squares", "sum"]
Kind = Literal["hinge", "slide"]
FAMILIES: tuple[Family, ...] = get_args(Family)
FRICTIONS = ("viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag")
"""Ids of the effects of `keycld_envs.effects` that a joint model can have at every joint."""


@dataclass(frozen=True)
class Scales:
    """Usual sizes of the signals, one per joint, so that networks see and give numbers near one.

    Attributes:
        centre: mean position, rad or m; it counts for slides only.
        position: standard deviation of positions, rad or m; it counts for slides only.
        velocity: of velocities, rad/s or m/s.
        acceleration: of accelerations, rad/s^2 or m/s^2.
        torque: of torques, N m or N.
    """

    centre: tuple[float, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    torque: tuple[float, ...]

    def __post_init__(self) -> None:
        for field in fields(self):
            for value in getattr(self, field.name):
                check_number(f"scales.{field.name}", value, -1e12 if field.name == "centre" else 0.0, 1e12)


@dataclass(frozen=True)
class JointConfig:
    """A joint model's architecture and the joints it is for.

    Attributes:
        joints: names, in the order of all arrays.
        kinds: "hinge" or "slide" of each.
        scales: usual sizes of the signals.
        family: the equations; see `keycld_model.delan.families`.
        width: units of each hidden layer.
        depth: hidden layers.
        friction: effects at every joint, of `FRICTIONS`.
        parts: models of the same joints, without friction, whose sum it is: of the family "sum" alone.
    """

    joints: tuple[str, ...]
    kinds: tuple[Kind, ...]
    scales: Scales
    family: Family = "structured"
    width: int = 24
    depth: int = 2
    friction: tuple[str, ...] = ()
    parts: tuple["JointConfig", ...] = ()

    def __post_init__(self) -> None:
        check_choice("family", self.family, FAMILIES)
        check_whole("width", self.width, 1, 1024)
        check_whole("depth", self.depth, 1, 8)
        for kind in self.kinds:
            check_choice("kinds", kind, get_args(Kind))
        for effect in self.friction:
            check_choice("friction", effect, FRICTIONS)
        if len(set(self.friction)) < len(self.friction):
            raise InputError(f"friction names an effect twice: {', '.join(self.friction)}; name each once.")
        if {"coulomb_friction", "stribeck_friction"} <= set(self.friction):
            raise InputError(
                "friction has Coulomb and Stribeck friction, which holds the former; leave one of them out."
            )
        if self.friction and self.family == "feed_forward":
            raise InputError("A feed-forward network has no friction of its own; leave friction empty.")
        sizes = {len(getattr(self.scales, f.name)) for f in fields(Scales)} | {len(self.kinds)}
        if sizes != {len(self.joints)} or not self.joints:
            raise InputError("joints, kinds and scales must be of one length, at least 1.")
        if (self.family == "sum") != bool(self.parts):
            raise InputError("parts belong to the family 'sum', which needs one at least.")
        if any(part.parts or part.friction or part.kinds != self.kinds for part in self.parts):
            raise InputError("parts must be of the same joints, and have neither friction nor parts of their own.")
        if self.parts and all(part.family == "feed_forward" for part in self.parts):
            raise InputError("parts are feed-forward networks alone; one of them must have equations of motion.")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def after_the_first(self) -> "JointConfig | None":
        """The same of all joints but the first; None if there is no other."""
        if self.n == 1:
            return None
        scales = Scales(*(getattr(self.scales, f.name)[1:] for f in fields(Scales)))
        return replace(self, joints=self.joints[1:], kinds=self.kinds[1:], scales=scales)

    def to_dict(self) -> dict[str, Any]:
        """JSON-compatible data, the inverse of `from_dict`."""
        data = asdict(self)
        del data["parts"]
        return data | ({"parts": [part.to_dict() for part in self.parts]} if self.parts else {})

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "JointConfig":
        """Read what `to_dict` wrote.

        Raises:
            InputError: if a field is missing, unknown or of another kind.
        """
        try:
            named: dict[str, Any] = {f.name: data[f.name] for f in fields(cls) if f.name != "parts"}
            scales = {f.name: tuple(float(x) for x in named["scales"][f.name]) for f in fields(Scales)}
            named |= {name: tuple(named[name]) for name in ("joints", "kinds", "friction")}
            named["scales"] = Scales(**scales)
            return cls(**named, parts=tuple(cls.from_dict(part) for part in data.get("parts", ())))
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"The configuration of a joint model is damaged: {error}") from error
