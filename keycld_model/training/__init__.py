"""Learning a world model from recordings."""

from keycld_model.training.data import TrainingData
from keycld_model.training.loop import TrainingError, TrainingResult, train
from keycld_model.training.presets import FINE_TUNING, PRESETS, Preset

__all__ = ["FINE_TUNING", "PRESETS", "Preset", "TrainingData", "TrainingError", "TrainingResult", "train"]
