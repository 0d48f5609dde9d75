"""How many single effects anybody could name: by how many nats the true form beats the nearest other one."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from keycld_control.benchmarks.blind.case import TRAINING, SealedCase, Signals, draw_case
from keycld_control.benchmarks.blind.grade import noiseless
from keycld_control.benchmarks.blind.make import GENERATOR, Settings, name
from keycld_control.benchmarks.blind.match import Key, joint_of
from keycld_control.benchmarks.blind.run import read_manifest
from keycld_control.benchmarks.blind.score import read_answers
from keycld_control.benchmarks.refitting import at_most, refit
from keycld_control.benchmarks.unfinished import finish
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file
from keycld_envs.reading import read_json
from keycld_model.diagnosis.search.criterion import Scored
from keycld_model.diagnosis.search.screening import promising
from keycld_model.diagnosis.search.search import Search

NOTHING = "nothing"
STARTS = 3
"""From which the true effect is fitted at each place, of those that promise most."""


@dataclass(frozen=True)
class Rival:
    """What comes nearest to the true form.

    Attributes:
        effect: its id, or `NOTHING`.
        joint: where; "*" where it has none.
        nats: by which the true form is expected to be likelier.
    """

    effect: str
    joint: str
    nats: float


@dataclass(frozen=True)
class Told:
    """How well recordings tell a single effect.

    Attributes:
        case: its number.
        effect: what is missing.
        joint: where; "*" where it has none.
        nearest: of another name.
        elsewhere: the nearest at another joint.
    """

    case: str
    effect: str
    joint: str
    nearest: Rival
    elsewhere: Rival

    @classmethod
    def read(cls, path: Path) -> "Told":
        """As it was written."""
        told = read_json(path)
        return cls(**{**told, **{key: Rival(**told[key]) for key in ("nearest", "elsewhere")}})


def ideal_observer(out: Path, workers: int = 1) -> dict[str, Any]:
    """How many of the clear single effects of a benchmark an ideal observer would name and place.

    It knows the forms of all effects and the noise; masses, lengths, zeros and the numbers of effects are to be told.
    All effects of the taxonomy are fitted, one at a time, to true positions with the noise of the case's grade. Where
    the likeliest other one fits d nats worse, the logarithm of the likelihood ratio is normal with mean d and variance
    2 d, and the observer prefers the true one with probability Phi(sqrt(d / 2)) (Green and Swets, Signal detection
    theory and psychophysics, 1966). An upper estimate: the nearest of several others counts alone, and a nearer one may
    not have been found.

    Args:
        out: folder of the benchmark, with its answers.
        workers: processes.

    Returns:
        Expected shares of names and places, and the nearest other effects of each case.

    Raises:
        InputError: if the benchmark is not complete, or of another version of the generator.
    """
    manifest = read_manifest(out)
    if manifest["generator"] != GENERATOR:
        raise InputError(
            f"{out} was made by generator {manifest['generator']}, this is generator {GENERATOR}; "
            "make the benchmark anew, or use the version of keycld that made it."
        )
    answers, folder = read_answers(out, manifest), out / "ideal-observer"
    clear = [i for i, a in enumerate(answers) if a["category"] == "one" and a["grade"] == "clear"]
    settings = Settings(manifest["seed"], manifest["cases"], manifest["observe"], tuple(manifest["only"]))
    finish(
        partial(_write, folder.resolve(), settings, answers),
        clear,
        lambda: {i for i in clear if (folder / f"{name(i)}.json").is_file()},
        folder,
        title="Fitting others",
        workers=workers,
    )
    told = [Told.read(folder / f"{name(i)}.json") for i in clear]
    return {
        "cases": len(told),
        "name": preferred([t.nearest for t in told]),
        "place": preferred([t.elsewhere for t in told]),
        "told": [asdict(t) for t in told],
    }


def preferred(rivals: Sequence[Rival]) -> float | None:
    """Share in which the true form is expected to be preferred."""
    return float(np.mean([norm.cdf(np.sqrt(r.nats / 2)) for r in rivals])) if rivals else None


def _write(folder: Path, settings: Settings, answers: Sequence[Mapping[str, Any]], index: int) -> None:
    case, signals = draw_case(settings.plans[index], (settings.seed, 1, index), settings.observe == "pixels")
    with atomic_file(folder / f"{name(index)}.json", "w") as file:
        json.dump(asdict(told_of(case, signals, answers[index])), file)


def told_of(case: SealedCase, signals: Sequence[Signals], answer: Mapping[str, Any]) -> Told:
    """How well the recordings of a case with a single effect tell it."""
    problem = at_most(noiseless(case, signals[:TRAINING], np.array(answer["noise"])))
    refitted = refit(problem)
    search = Search(problem, most_effects=1)
    search.run(refitted.point)
    (truth,) = answer["truth"]
    own = [h for h in search.hypotheses if h.effect.id == truth["effect"]]
    for key in {h.key for h in own}:
        for effects in promising(refitted, [h for h in own if h.key == key], {1: STARTS}):
            search.refine(refitted.point.with_effects(*effects), thoroughly=True)
    return _told(answer, [s for s in search.found.values() if len(s.keys) < 2])


def _told(answer: Mapping[str, Any], fits: Sequence[Scored]) -> Told:
    """How far others are from the true form; fits that are not of its own form cost what its form would, or more."""
    (truth,), system = answer["truth"], answer["system"]
    true = (str(truth["effect"]), joint_of(system, truth["where"]))
    costs = [(_key(system, s), s.fit.cost) for s in fits]
    least = min((cost for key, cost in costs if key == true), default=0.0)

    def nearest(others: Sequence[tuple[Key, float]]) -> Rival:
        key, cost = min(others, key=lambda other: other[1])
        return Rival(*key, max(0.0, float(cost - least)))

    return Told(
        answer["case"],
        *true,
        nearest=nearest([c for c in costs if c[0][0] != true[0]]),
        elsewhere=nearest([c for c in costs if c[0][1] != true[1] or c[0][0] == NOTHING]),
    )


def _key(system: str, scored: Scored) -> Key:
    if not scored.fit.effects:
        return NOTHING, "*"
    (effect,) = scored.fit.effects
    return effect.id, joint_of(system, {"kind": effect.kind, "name": effect.where})
