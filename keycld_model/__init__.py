"""KeyCLD world models: keypoints, a constrained Lagrangian and a renderer, learned from images."""

from importlib.metadata import version

from keycld_model.config import ModelConfig, NetworkConfig
from keycld_model.delan.model import JointModel
from keycld_model.world_model import Prediction, WorldModel

__all__ = ["JointModel", "ModelConfig", "NetworkConfig", "Prediction", "WorldModel"]
__version__ = version("keycld")
