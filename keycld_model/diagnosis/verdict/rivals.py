"""What the data do not exclude in place of the findings, and the recording that would."""

from dataclasses import dataclass
from functools import partial

from keycld_envs.effects import Effect
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.search.alternatives import everywhere_rivals, rivals_of
from keycld_model.diagnosis.search.budget import Budget
from keycld_model.diagnosis.search.criterion import Scored
from keycld_model.diagnosis.search.explain import Explanation
from keycld_model.diagnosis.verdict.dropped import Dropped
from keycld_model.diagnosis.verdict.next_experiment import next_experiment
from keycld_model.diagnosis.verdict.report import Experiment


@dataclass(frozen=True)
class Rivals:
    """Sets of effects that explain as much as the best.

    Attributes:
        explained: by training recordings.
        sets: for each effect of the best set, those with another in its place.
        dropped: what could not be compared; findings do not depend on it.
    """

    explained: Explanation
    sets: dict[tuple[str, str], list[Scored]]
    dropped: Dropped

    @classmethod
    def of(cls, explained: Explanation, dropped: Dropped, budget: Budget) -> "Rivals":
        """Sets that the search found, and others that are tried now; at the same places only, if there is no time."""
        search, best = explained.search, explained.best
        out = cls(explained, {effect.key: [] for effect in best.fit.effects}, dropped)
        for effect in best.fit.effects:
            name = f"rivals of {effect.id} at {effect.where}"
            out.sets[effect.key] += dropped.tried(name, partial(rivals_of, search, best, effect)) or []
        if not best.fit.effects or budget.leaves_out("rivals at other places"):
            return out
        for key, scored in (dropped.tried("rivals everywhere", partial(everywhere_rivals, search, best)) or {}).items():
            out.sets[key].append(scored)
        return out

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
        return self.dropped.tried("next experiment", partial(next_experiment, best, doubts, samples))

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
