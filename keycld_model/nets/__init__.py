"""Networks: images to keypoints, keypoints to images, positions to scalars and matrices. They know no physics."""

from keycld_model.nets.estimator import KeypointEstimator
from keycld_model.nets.fully_connected import FullyConnectedEstimator, FullyConnectedRenderer
from keycld_model.nets.mlp import MLP
from keycld_model.nets.renderer import Renderer
from keycld_model.nets.rigid_parts import RigidParts, rigid_parts

__all__ = [
    "MLP",
    "FullyConnectedEstimator",
    "FullyConnectedRenderer",
    "KeypointEstimator",
    "Renderer",
    "RigidParts",
    "rigid_parts",
]
