"""Recordings, checked, and cut into windows with noise and clocks known."""
