"""Numerical methods that know neither physics nor networks."""

from keycld_model.numerics.linear_algebra import null_space, solve_positive_definite
from keycld_model.numerics.runge_kutta import rk4_step

__all__ = ["null_space", "rk4_step", "solve_positive_definite"]
