"""What a world model is made of, as frozen dataclasses. One field changed is one ablation."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, get_args

from keycld_envs.checks import check_number, check_whole
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_envs.recordings import Dataset

Motion = Literal["constrained", "unconstrained", "acceleration"]
Images = Literal["convolutional", "fully_connected"]
WHOLE = (("width", 1, 1024), ("groups", 1, 1024), ("folding", 1, 4), ("hidden", 1, 16384))
"""Fields of `NetworkConfig` that are whole numbers, with the least and the most that make sense."""


@dataclass(frozen=True)
class NetworkConfig:
    """The networks. The defaults are for 2 CPU cores; `PAPER_NETWORKS` has the paper's values.

    Attributes:
        width: channels at the finest level of both hourglasses.
        groups: groups of their normalisations.
        folding: 2 folds 2x2 pixels into channels (a quarter of the arithmetic), 1 works at full resolution.
        saliency: height of a bump in the heatmaps where a frame differs from the mean frame; 0 has none.
        constants: channels of the renderer's constant tensor; None makes it and the Gaussian maps `width` together.
        gaussian_widths: standard deviations of the Gaussian maps, image units.
        segment_widths: standard deviations of distance maps of the rods, image units; empty has none.
        background: the renderer adds a learned logit per pixel, which starts at the mean frame.
        hidden: width of the hidden layers of V(x) and g(x).
        force_scale: factor on the outputs of V and g.
        kernel_scale: standard deviation of their initial weights; None scales with the layer's width.
        linear: V(x) and g(x) have a linear term beside the network. Gravity is linear in the positions of point
            masses, torques on rods and forces on sliders are too; the network has only the rest to explain.
        springs: beside a linear term, V(x) has a spring along each slider's rail.
        rod_masses: a rod between two joints has a mass in its middle, beside those of the keypoints: a link there has
            three numbers, two masses at its ends have two.
        rigid_parts: a second renderer draws each rigid part in coordinates that move with it; it tells more exactly
            than the first where joints are, and the state that a prediction starts from.
        motion: what moves the keypoints: a Lagrangian under the constraints, one without them (the paper's KeyCLD-NC),
            or a network for the acceleration (NODE2).
        images: estimator and renderer: hourglasses, or with fully connected layers in the middle (the paper's FC).
    """

    width: int = 16
    groups: int = 4
    folding: int = 2
    saliency: float = 9.0
    constants: int | None = 8
    gaussian_widths: tuple[float, ...] = (0.04, 0.1)
    segment_widths: tuple[float, ...] = (0.02, 0.05, 0.15)
    background: bool = True
    hidden: int = 32
    force_scale: float = 10.0
    kernel_scale: float | None = None
    linear: bool = True
    springs: bool = True
    rod_masses: bool = True
    rigid_parts: bool = False
    motion: Motion = "constrained"
    images: Images = "convolutional"

    def __post_init__(self) -> None:
        for name, choices in (("motion", get_args(Motion)), ("images", get_args(Images))):
            if getattr(self, name) not in choices:
                raise InputError(f"{name} is {getattr(self, name)!r}; it must be one of {', '.join(choices)}.")
        for name, least, most in WHOLE:
            check_whole(name, getattr(self, name), least, most)
        if self.width % self.groups:
            raise InputError(f"width is {self.width}; it must be a multiple of groups, {self.groups}.")
        if self.constants is not None:
            check_whole("constants", self.constants, 1, 1024)
        for name in ("gaussian_widths", "segment_widths"):
            for width in getattr(self, name):
                check_number(name, width, 0.0, 10.0)
        check_number("saliency", self.saliency, 0.0, 1e3, inclusive=True)
        check_number("force_scale", self.force_scale, 0.0, 1e6)
        if self.kernel_scale is not None:
            check_number("kernel_scale", self.kernel_scale, 0.0, 1e3)

    @property
    def identifiable(self) -> bool:
        """Few numbers describe the motion, so that second-order steps find them."""
        return self.linear and self.motion == "constrained"

    @property
    def halvings(self) -> int:
        """Times that the networks halve an image."""
        return 2 if self.images == "convolutional" else 4


PAPER_NETWORKS = NetworkConfig(
    width=32,
    groups=8,
    folding=1,
    saliency=0.0,
    constants=None,
    gaussian_widths=(0.1,),
    segment_widths=(),
    background=False,
    force_scale=1.0,
    kernel_scale=0.01,
    linear=False,
    springs=False,
    rod_masses=False,
    rigid_parts=False,
)
"""Appendix A.4 and table 2 of the KeyCLD paper."""

OF_OLDER_CHECKPOINTS = {"springs": False, "rod_masses": False, "rigid_parts": False}
"""Fields that checkpoints lack from before 2026-11-26, 2026-11-28 and 2026-11-30, with what was true without them."""


@dataclass(frozen=True)
class ModelConfig:
    """A world model's architecture and the system it is for.

    Attributes:
        mechanism: keypoints, rods and sliders.
        timestep: seconds between frames.
        image_shape: (H, W), pixels, multiples of 4 times the folding, or 16 times if fully connected.
        system: environment id, or None for a system without one.
        networks: sizes of the networks.
    """

    mechanism: Mechanism
    timestep: float
    image_shape: tuple[int, int] = (64, 64)
    system: str | None = None
    networks: NetworkConfig = NetworkConfig()

    def __post_init__(self) -> None:
        for size in self.image_shape:
            check_whole("image_shape", size, 1, 4096)
        multiple = 2**self.networks.halvings * self.networks.folding
        if any(size < multiple or size % multiple for size in self.image_shape):
            raise InputError(
                f"Frames of {self.image_shape[1]}x{self.image_shape[0]} pixels do not fit the networks; width and "
                f"height must be multiples of {multiple}: cut them with `keycld crop`."
            )
        check_number("timestep", self.timestep, 0.0, 10.0)

    @classmethod
    def of(cls, dataset: Dataset, mechanism: Mechanism, system: str | None, networks: NetworkConfig) -> "ModelConfig":
        """For recordings: their frame rate and image size.

        Raises:
            InputError: if frames are not square, or do not fit the networks.
        """
        sequences = dataset.sequences()
        height, width = sequences.frames.shape[2:4]
        config = cls(mechanism, round(sequences.timestep, 9), (height, width), system, networks)
        if height != width:
            raise InputError(
                f"Frames of {width}x{height} pixels are not square, so that rods seem to change their lengths as they "
                "turn; cut them with `keycld crop`."
            )
        return config

    def to_dict(self) -> dict[str, Any]:
        """JSON-compatible data, the inverse of `from_dict`."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "ModelConfig":
        """Read what `to_dict` wrote.

        Raises:
            InputError: if a field is missing or unknown.
        """
        try:
            networks = {**OF_OLDER_CHECKPOINTS, **data["networks"]}
            for name in ("gaussian_widths", "segment_widths"):
                networks[name] = tuple(networks[name])
            missing = {f.name for f in fields(NetworkConfig)} - set(networks)
            if missing:
                raise KeyError(*sorted(missing))
            return cls(
                mechanism=Mechanism.from_dict(data["mechanism"]),
                timestep=float(data["timestep"]),
                image_shape=(int(data["image_shape"][0]), int(data["image_shape"][1])),
                system=data["system"],
                networks=replace(NetworkConfig(), **networks),
            )
        except (LookupError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"The model configuration has a missing or unknown field: {error}.") from error
