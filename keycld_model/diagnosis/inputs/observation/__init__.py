"""What a sensor shows of a motion: one kind of observation per file, all of one protocol."""

from keycld_model.diagnosis.inputs.observation.joint_positions import JointPositions
from keycld_model.diagnosis.inputs.observation.nuisance import Nuisance
from keycld_model.diagnosis.inputs.observation.protocol import BoundedNoise, Observation

__all__ = ["BoundedNoise", "JointPositions", "Nuisance", "Observation"]
