"""How good a world model is, measured on recordings."""

from keycld_model.evaluation.evaluate import Evaluation, counted_sequences, evaluate
from keycld_model.evaluation.valid_prediction_time import (
    frame_errors,
    prediction_errors,
    squared_error,
    static_error,
    threshold,
    valid_frames,
)

__all__ = [
    "Evaluation",
    "counted_sequences",
    "evaluate",
    "frame_errors",
    "prediction_errors",
    "squared_error",
    "static_error",
    "threshold",
    "valid_frames",
]
