"""Trains and measures; every model leaves a file, so that nothing is done twice."""

import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from keycld_control.benchmarks.unfinished import finish
from keycld_control.delan.families import trained
from keycld_control.delan.plan import ALL, TEST, Training
from keycld_control.plain_json import write_json
from keycld_control.results import read_results
from keycld_envs.errors import InputError
from keycld_model.delan import Motions, read_motions
from keycld_model.delan.measures import score

SCHEMA = "keycld.delan/1"
PARTS = {"m": "inertial", "c": "coriolis", "g": "gravity"}
"""Of the torques, by their names in the file."""
KEPT = ("t", "qp", "tau", "labels", "lengths")
"""Arrays of the characters that stay where positions are noisy."""


def work_off(out: Path, data: Path, trainings: Sequence[Training], workers: int = 1, ray: str | None = None) -> None:
    """Do what is missing.

    Args:
        out: folder of the report.
        data: the characters.
        trainings: what is to be done.
        workers: processes.
        ray: address of a Ray cluster to do it on instead.

    Raises:
        InputError: if the data are not the characters, or results are of other data.
    """
    characters(data)
    whole, out, data = read_motions(data).sha256, out.resolve(), data.resolve()
    for result in results(out):
        if result["data"] != whole:
            raise InputError(f"{out} holds results of other data than {data}; choose another --out.")

    def done() -> set[int]:
        return {i for i, training in enumerate(trainings) if _file(out, training).is_file()}

    finish(partial(_do, out, data, whole, trainings), range(len(trainings)), done, out, "Models", workers, ray)


def _do(out: Path, data: Path, whole: str, trainings: Sequence[Training], number: int) -> None:
    """Train and measure a model, and write its file."""
    training = trainings[number]
    _, test = _characters(data)
    rest, _ = _characters(data, training.noise, training.seed if training.noise else 0)
    motions, folder = amount(rest, training), out / "models" / training.name
    model, about = trained(training.model, motions, folder, training.seed)
    scores = asdict(score(model, test))
    write_json(_file(out, training), {"schema": SCHEMA, "data": whole, **asdict(training), **about, "scores": scores})


def characters(data: Path) -> tuple[Motions, Motions]:
    """Those to learn from, and those of the test.

    Raises:
        InputError: if the file has others, or no true parts of the torques.
    """
    rest, test = _held_out(data)
    if missing := [key for key, part in PARTS.items() if test.truth(part) is None]:
        raise InputError(f"{data} has no {missing[0]}, a true part of the torques; name the characters of the papers.")
    return rest, test


def _held_out(data: Path) -> tuple[Motions, Motions]:
    """The same, whether or not the parts of their torques are known."""
    rest, test = read_motions(data).hold_out(TEST)
    if len(rest) < ALL:
        raise InputError(f"{data} has {len(rest)} characters beside {', '.join(TEST)}; the experiment has {ALL}.")
    return rest, test


@cache
def _characters(data: Path, noise: float = 0.0, seed: int = 0) -> tuple[Motions, Motions]:
    """Those to learn from, and those of the test; with noise, known by positions and torques alone."""
    if not noise:
        return characters(data)
    with np.load(data) as archive:
        arrays = {name: archive[name] for name in archive.files if name in KEPT}
    clean = arrays["qp"]
    arrays["qp"] = clean + noise * clean.std(axis=0) * np.random.default_rng([seed, 1]).standard_normal(clean.shape)
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / data.name, **arrays)
        return _held_out(Path(folder) / data.name)


def amount(rest: Motions, training: Training) -> Motions:
    """As many characters as asked for, drawn by the seed."""
    order = np.random.default_rng(training.seed).permutation(len(rest))[: training.characters]
    return rest.chosen([rest.ids[i] for i in sorted(order)])


def _file(out: Path, training: Training) -> Path:
    return out / "results" / f"{training.name}.json"


def results(out: Path) -> list[dict[str, Any]]:
    """All figures that are there, in order of their names.

    Raises:
        InputError: if a file is damaged or of another version.
    """
    return [result for _, result in read_results(out, SCHEMA)]
