"""Effects that can be asked for of a simulator, and where."""

from typing import TypeVar

import mujoco

from keycld_envs.effects import EFFECTS, AddedInertia, Cogging, Effect, LoadDependentFriction, Spring
from keycld_model.delan.rig import learned_dynamics

Kind = TypeVar("Kind", bound=Effect)


def places_of(kind: type[Kind], model: mujoco.MjModel) -> tuple[Kind, ...]:
    """An effect at each place where it can be, absent as yet."""
    return () if learned_dynamics(model) is not None and _not_of_joint_models(kind) else kind.candidates(model)


def not_asked(model: mujoco.MjModel) -> list[str]:
    """Effects that a search tries of bodies, but not of a joint model."""
    if learned_dynamics(model) is None:
        return []
    kinds = [kind for kind in EFFECTS.values() if kind.searched and _not_of_joint_models(kind)]
    return sorted({f"{kind.id} ({kind.kind})" for kind in kinds})


def _not_of_joint_models(kind: type[Effect]) -> bool:
    """Whether an effect is of bodies, gravity or the base, which joint models do not know, or as their own errors are.

    Energies that depend on positions, and rotors, are what a joint model learns and is a little off in.
    """
    return kind.kind in ("body", "world") or issubclass(kind, LoadDependentFriction | AddedInertia | Cogging | Spring)
