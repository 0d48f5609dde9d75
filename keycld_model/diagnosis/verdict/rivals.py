"""What the data do not exclude in place of the findings, and the recording that would."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from keycld_envs.effects import Effect
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.search.alternatives import everywhere_rivals, rivals_of
from keycld_model.diagnosis.search.criterion import Scored
from keycld_model.diagnosis.search.explain import Explanation
from keycld_model.diagnosis.verdict.next_experiment import next_experiment
from keycld_model.diagnosis.verdict.report import Experiment

T = TypeVar("T")


@dataclass(frozen=True)
class Rivals:
    """Sets of effects that explain as much as the best.

    Attributes:
        explained: by training recordings.
        sets: for each effect of the best set, those with another in its place.
        dropped: what could not be compared, and why, a line each; findings do not depend on it.
    """

    explained: Explanation
    sets: dict[tuple[str, str], list[Scored]]
    dropped: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, explained: Explanation) -> "Rivals":
        """Sets that the search found, and others that are tried now."""
        search, best = explained.search, explained.best
        out = cls(explained, {effect.key: [] for effect in best.fit.effects})
        for effect in best.fit.effects:
            name = f"rivals of {effect.id} at {effect.where}"
            out.sets[effect.key] += out._tried(name, lambda e=effect: rivals_of(search, best, e)) or []
        for key, scored in (out._tried("rivals everywhere", lambda: everywhere_rivals(search, best)) or {}).items():
            out.sets[key].append(scored)
        return out

    def _tried(self, name: str, compare: Callable[[], T]) -> T | None:
        """A comparison; None, with a line in `dropped`, if numbers run away in it."""
        try:
            return compare()
        except (ValueError, ArithmeticError) as error:
            self.dropped.append(f"{name}: {error}")
            return None

    def others(self, effect: Effect) -> set[tuple[str, str, str]]:
        """Id, kind and place of effects that are not excluded in one's place."""
        keys = self.explained.best.keys
        others = {(e.id, e.kind, e.where) for s in self.sets[effect.key] for e in s.fit.effects if e.key not in keys}
        return others - {(effect.id, effect.kind, effect.where)}

    def next_experiment(self, samples: int, nothing: bool) -> Experiment | None:
        """A motion of a number of samples that would tell them apart, and from nothing, if `nothing` may be missing.

        None where there is nothing to tell, or nothing to do.
        """
        doubts = self._doubts(nothing)
        if not doubts:
            return None
        best = self.explained.best.fit
        return self._tried("next experiment", lambda: next_experiment(best, doubts, samples))

    def _doubts(self, nothing: bool) -> list[tuple[str, Fit]]:
        """Rivals of the best set by name, and the refitted simulator if `nothing` may be missing."""
        best, out = self.explained.best, [("nothing", self.explained.refitted)] if nothing else []
        for effect in best.fit.effects:
            for s in self.sets[effect.key]:
                other = next(e for e in s.fit.effects if e.key not in best.keys)
                out.append((rival_name(other, effect), s.fit))
        return out


def rival_name(rival: Effect, effect: Effect) -> str:
    """What an effect in another's place is called."""
    return rival.id if rival.where == effect.where else f"{rival.id} at {rival.where}"
