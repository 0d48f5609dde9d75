"""Numerical methods that know neither physics nor networks."""

from keycld_model.numerics.bounded import bounded_minimum
from keycld_model.numerics.evenly_spaced import evenly_spaced
from keycld_model.numerics.linear_algebra import null_space, solve_positive_definite
from keycld_model.numerics.runge_kutta import rk4_step

__all__ = ["bounded_minimum", "evenly_spaced", "null_space", "rk4_step", "solve_positive_definite"]
