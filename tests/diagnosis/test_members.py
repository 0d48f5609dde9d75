"""Which member of a family is named, where it is certain that one of them is there."""

from types import SimpleNamespace
from typing import Any

import pytest

from keycld_envs.effects import ActuatorGain, CoulombFriction, Effect, StribeckFriction
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.discrepancy.selection import Ranked, Selection


def ranked(effect: Effect, gain: float, chance: float) -> Ranked:
    difference: Any = SimpleNamespace(gain=gain, candidate=SimpleNamespace(hypothesis=SimpleNamespace(effect=effect)))
    return Ranked(difference, chance)


COULOMB, STRIBECK = CoulombFriction("hinge"), StribeckFriction("hinge")


@pytest.mark.parametrize(
    "candidates, clear",
    [
        ([(STRIBECK, 70.0, 5.4), (COULOMB, 51.0, 1.5)], [STRIBECK, COULOMB]),
        ([(STRIBECK, 70.0, 5.4), (COULOMB, 51.0, 3.0)], []),
        ([(ActuatorGain("motor"), 75.0, 5.4), (COULOMB, 61.0, 1.5)], [COULOMB]),
    ],
    ids=["one of the family is sure", "none is", "another family is not sure"],
)
def test_scores_tell_which_member_of_a_family_it_is(
    candidates: list[tuple[Effect, float, float]], clear: list[Effect]
) -> None:
    none: Any = None
    selection = Selection(none, [], none, none, none, none, STANDARD, {})
    found = selection._clear([ranked(*c) for c in candidates])
    assert [r.effect for r in found] == clear
