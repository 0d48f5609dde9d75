"""Effects as JSON: in checkpoints of world models, and as findings of a diagnosis."""

from collections.abc import Iterable
from typing import Any

from keycld_envs.effects import Effect, effect_class
from keycld_envs.effects.added_physics import check_numbers
from keycld_envs.errors import InputError


def effect_to_json(effect: Effect) -> dict[str, Any]:
    """Name, place and numbers, in the form that findings of a diagnosis have."""
    return {
        "effect": effect.id,
        "where": {"kind": effect.kind, "name": effect.where},
        "parameters": {p.name: {"value": float(getattr(effect, p.name)), "unit": p.unit} for p in effect.parameters()},
    }


def effects_from_json(found: Iterable[Any], source: str) -> tuple[Effect, ...]:
    """Effects of what `effect_to_json`, or a diagnosis' report, has written.

    Args:
        found: one dictionary per effect.
        source: file and field, for errors.

    Raises:
        InputError: if one is unknown, or not complete.
    """
    out = []
    for one in found:
        try:
            name, where = one["effect"], one["where"]
            numbers = {key: float(number["value"]) for key, number in one["parameters"].items()}
            kind = effect_class(name, where["kind"])
            if kind is None:
                raise InputError(f"{source} has {name!r} at a {where['kind']}, which is no effect; leave it out.")
            effect = kind(where["name"], **numbers)
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{source} has an effect without its name, place or numbers ({error}).") from error
        check_numbers(effect)
        out.append(effect)
    return tuple(out)
