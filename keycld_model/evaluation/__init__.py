"""How good a world model is, measured on recordings."""

from keycld_model.evaluation.evaluate import Evaluation, evaluate
from keycld_model.evaluation.valid_prediction_time import prediction_errors, static_error, valid_frames

__all__ = ["Evaluation", "evaluate", "prediction_errors", "static_error", "valid_frames"]
