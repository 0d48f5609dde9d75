"""What the cases are, before any number is drawn: the mix, spread evenly over effects, places and excitations."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from keycld_control.benchmarks.blind.excite import EXCITATIONS, Excitation
from keycld_control.benchmarks.blind.outside_strengths import OUTSIDE, possible
from keycld_control.benchmarks.blind.sites import SYSTEMS, Site, sites
from keycld_control.benchmarks.blind.strengths import DRIVEN, GLOBAL, LIBRARY

Category = Literal["null", "one", "two", "three", "outside"]
MIX: dict[Category, float] = {"null": 0.25, "one": 0.35, "two": 0.2, "three": 0.05, "outside": 0.15}
"""Share of each category among all cases."""
CATEGORIES = tuple(MIX)
T = TypeVar("T")


@dataclass(frozen=True)
class Plan:
    """What a case is, before any number is drawn.

    Attributes:
        category: of the mix.
        system: short name.
        excitation: how the mechanism is moved.
        parts: effects of the taxonomy, or one kind outside it, each with its site.
    """

    category: Category
    system: str
    excitation: Excitation
    parts: tuple[tuple[str, Site], ...] = ()


def plan(cases: int, seed: int, only: Sequence[Category] = CATEGORIES) -> list[Plan]:
    """Plans of all cases in the order of their numbers, which tells nothing about them.

    Args:
        cases: their number.
        seed: of all that is drawn.
        only: categories; their shares keep their proportions.
    """
    rng, counts = np.random.default_rng([seed, 0]), _counts(cases, only)
    out = _nulls(counts["null"], rng) + _singles(counts["one"], rng) + _outside(counts["outside"], rng)
    out += _sets("two", 2, counts["two"], rng) + _sets("three", 3, counts["three"], rng)
    return [out[i] for i in rng.permutation(len(out))]


def _counts(cases: int, only: Sequence[Category]) -> dict[Category, int]:
    """How many cases there are of each category."""
    rest: Category = "one" if "one" in only else only[0]
    shares: dict[Category, float] = {c: share if c in only else 0.0 for c, share in MIX.items()}
    counts: dict[Category, int] = {c: round(share / sum(shares.values()) * cases) for c, share in shares.items()}
    counts[rest] += cases - sum(counts.values())
    return counts


def mix(plans: Sequence[Plan]) -> dict[str, int]:
    """How many plans there are of each category."""
    return dict(Counter(p.category for p in plans))


def _endless(items: Sequence[T], rng: np.random.Generator) -> Iterator[T]:
    """All items in random order, again and again."""
    while True:
        yield from (items[i] for i in rng.permutation(len(items)))


def _nulls(number: int, rng: np.random.Generator) -> list[Plan]:
    kinds = _endless([Plan("null", s, e) for s in SYSTEMS for e in EXCITATIONS], rng)
    return [next(kinds) for _ in range(number)]


def _excitations(driven: bool) -> tuple[Excitation, ...]:
    return EXCITATIONS[1:] if driven else EXCITATIONS


def _places(effect: str) -> list[Site]:
    """Sites at which an effect can be; effects without a joint of their own once per system."""
    return [s for system in SYSTEMS for s in sites(system)[: 1 if effect in GLOBAL else None]]


def _singles(number: int, rng: np.random.Generator) -> list[Plan]:
    places = {effect: _endless(_places(effect), rng) for effect in LIBRARY}
    moves = {driven: _endless(_excitations(driven), rng) for driven in (False, True)}
    effects = _endless(list(LIBRARY), rng)
    out = []
    for _ in range(number):
        effect = next(effects)
        site = next(places[effect])
        out.append(Plan("one", site.system, next(moves[effect in DRIVEN]), ((effect, site),)))
    return out


def _sets(category: Category, size: int, number: int, rng: np.random.Generator) -> list[Plan]:
    """Different effects on one system; at most one of them between a motor and its joint."""
    systems = _endless(SYSTEMS, rng)
    effects, out = _endless(list(LIBRARY), rng), []
    while len(out) < number:
        chosen: list[str] = []
        while len(chosen) < size:
            effect = next(effects)
            between = effect in ("backlash", "joint_flexibility")
            if effect not in chosen and not (between and {"backlash", "joint_flexibility"} & set(chosen)):
                chosen.append(effect)
        system = next(systems)
        kinds = _excitations(any(effect in DRIVEN for effect in chosen))
        where = sites(system)
        parts = tuple((e, where[0 if e in GLOBAL else int(rng.integers(len(where)))]) for e in chosen)
        out.append(Plan(category, system, kinds[int(rng.integers(len(kinds)))], parts))
    return out


def _outside(number: int, rng: np.random.Generator) -> list[Plan]:
    kinds, out = _endless(list(OUTSIDE), rng), []
    moves = {driven: _endless(_excitations(driven), rng) for driven in (False, True)}
    places = {k: _endless([s for y in SYSTEMS for s in sites(y) if possible(k, s, True)], rng) for k in OUTSIDE}
    for _ in range(number):
        kind = next(kinds)
        site = next(places[kind])
        out.append(Plan("outside", site.system, next(moves[kind == "efficiency"]), ((kind, site),)))
    return out
