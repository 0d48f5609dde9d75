"""Deep Lagrangian Networks and their rivals: dynamics of joints, learned from positions, velocities and torques."""

from keycld_model.delan.config import FRICTIONS, JointConfig
from keycld_model.delan.model import Decomposition, JointModel
from keycld_model.delan.motions import Motion, Motions
from keycld_model.delan.presets import PRESETS, Preset
from keycld_model.delan.read import motions_of, read_motions
from keycld_model.delan.training import TrainingResult, train

__all__ = [
    "FRICTIONS",
    "PRESETS",
    "Decomposition",
    "JointConfig",
    "JointModel",
    "Motion",
    "Motions",
    "Preset",
    "TrainingResult",
    "motions_of",
    "read_motions",
    "train",
]
