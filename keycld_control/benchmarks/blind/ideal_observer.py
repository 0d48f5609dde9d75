"""How well single effects can be told at all: by how many nats the true form is likelier than the nearest other one."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from keycld_control.benchmarks.blind.case import TRAINING, SealedCase, Signals, draw_case
from keycld_control.benchmarks.blind.grade import noiseless, true_nuisances
from keycld_control.benchmarks.blind.make import Settings, name
from keycld_control.benchmarks.blind.match import joint_of
from keycld_control.benchmarks.blind.run import read_manifest
from keycld_control.benchmarks.blind.score import read_answers
from keycld_control.benchmarks.refitting import Fit, at_most, minimise, refit
from keycld_control.benchmarks.unfinished import finish
from keycld_envs.effects import EFFECTS
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file
from keycld_envs.reading import read_json
from keycld_model.diagnosis.search.hypotheses import hypotheses, recorded_range
from keycld_model.diagnosis.search.screening import promising

NOTHING = "nothing"
ITERATIONS = 40
"""Steps of Gauss-Newton of each fit, at most."""


@dataclass(frozen=True)
class Form:
    """An effect at a place, fitted to true positions.

    Attributes:
        effect: its id, or `NOTHING`.
        joint: where; "*" where it has none.
        numbers: how many parameters it has.
        nats: what the fit costs, or by how much the true form is likelier.
    """

    effect: str
    joint: str
    numbers: int
    nats: float


@dataclass(frozen=True)
class Separation:
    """How far the true form of a case is from all others.

    Attributes:
        case: its number.
        true: what is missing, with its cost.
        others: of another name or at another place, with as many parameters or fewer, and nothing at all.
    """

    case: str
    true: Form
    others: tuple[Form, ...]

    @classmethod
    def read(cls, path: Path) -> "Separation":
        """As it was written."""
        read = read_json(path)
        return cls(read["case"], Form(**read["true"]), tuple(Form(**other) for other in read["others"]))

    @property
    def nearest(self) -> Form:
        """The nearest of another name."""
        return self._behind([o for o in self.others if o.effect != self.true.effect])

    @property
    def elsewhere(self) -> Form:
        """The nearest at another joint, or nothing."""
        return self._behind([o for o in self.others if o.joint != self.true.joint or o.effect == NOTHING])

    def _behind(self, others: Sequence[Form]) -> Form:
        best = min(others, key=lambda other: other.nats)
        return Form(best.effect, best.joint, best.numbers, max(0.0, best.nats - self.true.nats))


def ideal_observer(out: Path, workers: int = 1) -> dict[str, Any]:
    """How many clear single effects of a benchmark can be told from the nearest other form, by name and by place.

    Effects of the taxonomy with as many parameters as the true one, or fewer, are fitted one at a time, with masses,
    lengths and zeros, to the true positions in the windows that the diagnosis uses, weighed by the noise of the case's
    grade. If the likeliest other one is d nats behind, an observer who knows both forms and the noise, and to whom
    both are as probable, tells them apart with probability Phi(sqrt(d / 2)): the logarithm of their likelihood ratio is
    normal with mean d and variance 2 d (Green and Swets, Signal detection theory and psychophysics, 1966). It is an
    estimate: others may fit better than was found, those with more parameters are left out, and longer windows would
    tell more.

    Args:
        out: folder of the benchmark, with its answers.
        workers: processes.

    Returns:
        Mean probabilities of names and places, and for each case the nearest other forms.

    Raises:
        InputError: if the benchmark is not complete, or this version draws other cases.
    """
    manifest = read_manifest(out)
    answers, folder = read_answers(out, manifest), out / "ideal-observer"
    clear = [i for i, a in enumerate(answers) if a["category"] == "one" and a["grade"] == "clear"]
    settings = Settings(manifest["seed"], manifest["cases"], manifest["observe"], tuple(manifest["only"]))
    finish(
        partial(_write, folder.resolve(), settings, answers),
        clear,
        lambda: {i for i in clear if (folder / f"{name(i)}.json").is_file()},
        folder,
        title="Fitting other effects",
        workers=workers,
    )
    told = [Separation.read(folder / f"{name(i)}.json") for i in clear]
    return {
        "cases": len(told),
        "name": told_apart([t.nearest for t in told]),
        "place": told_apart([t.elsewhere for t in told]),
        "told": [
            {"case": t.case, **{key: asdict(getattr(t, key)) for key in ("true", "nearest", "elsewhere")}} for t in told
        ],
    }


def told_apart(others: Sequence[Form]) -> float | None:
    """Mean probability with which the true form is preferred to one that is so many nats behind."""
    return float(np.mean([norm.cdf(np.sqrt(o.nats / 2)) for o in others])) if others else None


def _write(folder: Path, settings: Settings, answers: Sequence[Mapping[str, Any]], index: int) -> None:
    case, signals = draw_case(settings.plans[index], (settings.seed, 1, index), settings.observe == "pixels")
    drawn = {**asdict(case.errors), "zero": case.zero.tolist()}
    if drawn != answers[index]["nuisance"]:
        raise InputError(
            f"{folder.parent}: this version of keycld draws case {name(index)} otherwise; use the one that made it."
        )
    with atomic_file(folder / f"{name(index)}.json", "w") as file:
        json.dump(asdict(separation(case, signals, answers[index])), file)


def separation(case: SealedCase, signals: Sequence[Signals], answer: Mapping[str, Any]) -> Separation:
    """How far the true form of a case with a single effect is from others."""
    problem = at_most(noiseless(case, signals[:TRAINING], np.array(answer["noise"])))
    refitted, (truth,), system = refit(problem), answer["truth"], answer["system"]
    known = hypotheses(problem.simulator.model, recorded_range(problem.windows))
    numbers = max(len(kind.parameters()) for kind in EFFECTS.values() if kind.id == truth["effect"])
    free = [h for h in known if len(h.effect.parameters()) <= numbers]
    fits = [
        minimise(problem, refitted.point.with_effects(*effects), ITERATIONS)
        for effects in promising(refitted, free, {1: len({h.key for h in free})})
    ]
    forms = [Form(NOTHING, "*", 0, refitted.cost), *(_form(system, fit) for fit in fits)]
    true = truth["effect"], joint_of(system, truth["where"])
    exact = 0.5 * float(np.sum((true_nuisances(case, problem) / problem.spreads) ** 2))
    least = min([exact, *(f.nats for f in forms if (f.effect, f.joint) == true)])
    others = tuple(f for f in forms if (f.effect, f.joint) != true)
    return Separation(answer["case"], Form(*true, numbers, least), others)


def _form(system: str, fit: Fit) -> Form:
    (effect,) = fit.effects
    where = joint_of(system, {"kind": effect.kind, "name": effect.where})
    return Form(effect.id, where, len(effect.parameters()), float(fit.cost))
