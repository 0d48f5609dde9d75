"""What the track of a free pendulum tells: period, damping, and how both depend on the amplitude."""

from keycld_model.tracking.pendulum.study import Study, study_pendulum

__all__ = ["Study", "study_pendulum"]
