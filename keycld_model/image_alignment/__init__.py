"""Joint positions from images: a simulator is drawn, and moved until its picture is that of each frame."""

from keycld_model.image_alignment.positions import Positions, read_positions

__all__ = ["Positions", "read_positions"]
