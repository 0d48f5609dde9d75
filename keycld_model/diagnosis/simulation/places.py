"""Effects that can be asked for of a simulator, and where."""

from typing import TypeVar

import mujoco

from keycld_envs.effects import EFFECTS, Effect, LoadDependentFriction
from keycld_model.delan.rig import learned_dynamics

Kind = TypeVar("Kind", bound=Effect)


def places_of(kind: type[Kind], model: mujoco.MjModel) -> tuple[Kind, ...]:
    """An effect at each place where it can be, absent as yet."""
    return () if learned_dynamics(model) is not None and _needs_bodies(kind) else kind.candidates(model)


def not_asked(model: mujoco.MjModel) -> list[str]:
    """Effects that a search tries of bodies, but not of a joint model, which knows joints alone."""
    if learned_dynamics(model) is None:
        return []
    return sorted({f"{kind.id} ({kind.kind})" for kind in EFFECTS.values() if kind.searched and _needs_bodies(kind)})


def _needs_bodies(kind: type[Effect]) -> bool:
    """The effect is of bodies, of gravity or of the base, or of the forces that bearings carry."""
    return kind.kind in ("body", "world") or issubclass(kind, LoadDependentFriction)
