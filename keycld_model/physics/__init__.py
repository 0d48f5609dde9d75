"""Lagrangian mechanics of point masses under holonomic constraints. Knows no network.

Every function is unbatched (`jax.vmap` adds batches). Positions are flat `[n]` vectors, n = 2K, in image units.
"""

from keycld_model.physics.constraints import constraint, constraint_curvature, constraint_jacobian
from keycld_model.physics.integrators import INTEGRATORS, Integrator, PointMasses, in_parts, in_turns
from keycld_model.physics.lagrangian import acceleration
from keycld_model.physics.masses import heavy_rods, kinetic_energy, lumped, mass_matrix, momentum
from keycld_model.physics.projection import project_position, project_velocity

__all__ = [
    "INTEGRATORS",
    "Integrator",
    "PointMasses",
    "acceleration",
    "constraint",
    "constraint_curvature",
    "constraint_jacobian",
    "heavy_rods",
    "in_parts",
    "in_turns",
    "kinetic_energy",
    "lumped",
    "mass_matrix",
    "momentum",
    "project_position",
    "project_velocity",
]
