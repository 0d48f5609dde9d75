"""Mechanisms in real video: keypoints, pivots and angles from their motion, without a simulator of the scene."""

from keycld_model.tracking.track import Track, read, steps, track

__all__ = ["Track", "read", "steps", "track"]
