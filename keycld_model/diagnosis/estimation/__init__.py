"""Least squares on trajectories."""
