"""Dry friction of joints: as stiction that is exact over a step, and as the soft constraint that MuJoCo has.

MuJoCo's constraint creeps: after a reversal that is milliradians, more than sensors' noise. Exact stiction stops a
joint, and holds it.
"""

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from keycld_model.rigid_body.scalars import Scalar, Traced, add, mul, solve

SWEEPS = 12
"""Gauss-Seidel sweeps over joints with dry friction that hold each other."""


def exact_stiction(
    system: Callable[[], tuple[list[list[Scalar]], list[Scalar]]], most: Traced, begun: Traced, h: Traced
) -> Traced:
    """Mean dry friction `[nv, N]` over a step.

    A joint slides until it stops, and is held from then on unless the other forces exceed what holds it.

    Args:
        system: gives the mass matrix and the other forces on the joints in the middle of the step.
        most: `[nv, N]` greatest friction, N m or N.
        begun: `[nv, N]` velocities at the start.
        h: s.
    """
    nv = len(begun)

    def rubbing() -> Traced:
        mass, force = system()
        free, one = solve(mass, force), jnp.ones_like(begun[0])
        given = [solve(mass, [one if i == j else 0.0 for j in range(nv)]) for i in range(nv)]

        def sweep(friction: Traced, _: None) -> tuple[Traced, None]:
            forces = list(friction)
            for j in range(nv):
                others = functools.reduce(add, [mul(given[i][j], forces[i]) for i in range(nv) if i != j], free[j])
                forces[j] = _stopping(begun[j], others, given[j][j], most[j], h)
            return jnp.stack(forces), None

        return jax.lax.scan(sweep, -most * jnp.sign(begun), None, length=SWEEPS if nv > 1 else 1)[0]

    return jax.lax.cond(jnp.any(most > 0), rubbing, lambda: jnp.zeros_like(begun))


def _stopping(v: Traced, others: Scalar, mobility: Scalar, most: Traced, h: Traced) -> Traced:
    """Mean dry friction over a step for the speed at its start, and the acceleration without; all `[N]`."""
    slide, hold = -most * jnp.sign(v), jnp.clip(-others / mobility, -most, most)
    change = others + mobility * slide
    stops = v * (v + h * change) <= 0
    time = jnp.where(stops & (change != 0), jnp.clip(-v / jnp.where(change == 0, 1.0, change), 0.0, h), 0.0)
    return jnp.where(stops, (slide * time + hold * (h - time)) / h, slide)


class _SoftFriction:
    """MuJoCo's soft constraint on joints, see `soft_friction`."""

    def __init__(
        self,
        mass: list[list[Scalar]],
        force: list[Scalar],
        joints: Sequence[tuple[Traced, ...]],
        v: Traced,
    ) -> None:
        self.mass, self.force, self.joints = mass, force, joints
        self.stop = [-damping * v[j] for j, (_, _, damping) in enumerate(joints)]
        self.v = v

    def forces(self, acceleration: Traced) -> tuple[list[Traced], list[Traced]]:
        """Forces of the constraint at accelerations, and whether each joint sticks."""
        wanted = [(self.stop[j] - acceleration[j]) / regular for j, (_, regular, _) in enumerate(self.joints)]
        forces = [jnp.clip(w, -most, most) for w, (most, _, _) in zip(wanted, self.joints, strict=True)]
        return forces, [jnp.abs(w) < most for w, (most, _, _) in zip(wanted, self.joints, strict=True)]

    def accelerations(self, forces: list[Traced], sticks: list[Traced]) -> Traced:
        """Accelerations if these joints stick and the others have these forces."""
        stiff, right = [list(row) for row in self.mass], []
        for j, (_, regular, _) in enumerate(self.joints):
            stiff[j][j] = stiff[j][j] + jnp.where(sticks[j], 1 / regular, 0.0)
            right.append(self.force[j] + jnp.where(sticks[j], self.stop[j] / regular, forces[j]))
        return jnp.stack(solve(stiff, right))

    def relaxed(self) -> Traced:
        """Forces after sweeps of projected Gauss-Seidel, which find the joints that stick."""
        nv, free = len(self.force), solve(self.mass, self.force)
        one = jnp.ones_like(self.v[0])
        given = [solve(self.mass, [one if i == j else 0.0 for j in range(nv)]) for i in range(nv)]

        def sweep(friction: Traced, _: None) -> tuple[Traced, None]:
            forces = list(friction)
            for j, (most, regular, _damping) in enumerate(self.joints):
                acceleration = free[j] + functools.reduce(add, [mul(given[i][j], forces[i]) for i in range(nv)])
                change = (self.stop[j] - acceleration - regular * forces[j]) / (given[j][j] + regular)
                forces[j] = jnp.clip(forces[j] + change, -most, most)
            return jnp.stack(forces), None

        return jax.lax.scan(sweep, jnp.zeros_like(self.v), None, length=2 * nv)[0]

    def solved(self) -> Traced:
        """Forces `[nv, N]`: two Newton steps from the relaxed ones are exact."""
        friction = self.relaxed()
        first = jnp.stack(solve(self.mass, [f + r for f, r in zip(self.force, friction, strict=True)]))

        def newton(acceleration: Traced, _: None) -> tuple[Traced, None]:
            return self.accelerations(*self.forces(acceleration)), None

        acceleration, _ = jax.lax.scan(newton, first, None, length=2)
        return jnp.stack(self.forces(acceleration)[0])


def soft_friction(
    mass: list[list[Scalar]], force: list[Scalar], joints: Sequence[tuple[Traced, ...]], v: Traced
) -> list[Traced]:
    """Dry friction of joints as MuJoCo's soft constraint has it, by Newton steps on which joints slip.

    Args:
        mass: `[nv][nv]` mass matrix.
        force: `[nv]` other forces, N m or N.
        joints: per joint greatest friction, how soft its constraint is, and its damping, 1/s.
        v: `[nv, N]` velocities.
    """
    soft = _SoftFriction(mass, force, joints, v)
    anywhere = functools.reduce(jnp.logical_or, [jnp.any(joint[0] > 0) for joint in joints])
    return list(jax.lax.cond(anywhere, soft.solved, lambda: jnp.zeros_like(v)))
