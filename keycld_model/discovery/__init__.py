"""The structure of a mechanism from its frames alone: parts, the joints between them, keypoints, rods and sliders."""

from keycld_model.discovery.declaration import Declaration, declare, doubts
from keycld_model.discovery.frames import Frames, read_frames
from keycld_model.discovery.parts import Placed, placed
from keycld_model.discovery.structure import PRICE, Discovery, Structure, discover, steps

__all__ = [
    "PRICE",
    "Declaration",
    "Discovery",
    "Frames",
    "Placed",
    "Structure",
    "declare",
    "discover",
    "doubts",
    "placed",
    "read_frames",
    "steps",
]
