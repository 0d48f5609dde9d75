"""Recordings, checked and cut into windows, and what a sensor shows of a motion."""
