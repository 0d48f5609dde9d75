"""Trains and measures; every model leaves a file, so that nothing is done twice."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from keycld_control.delan.families import trained
from keycld_control.delan.plan import ALL, TEST, Training
from keycld_control.plain_json import write_json
from keycld_control.results import read_results
from keycld_envs.errors import InputError
from keycld_envs.files import one_writer
from keycld_envs.progress import progress
from keycld_model.delan import Motions, read_motions
from keycld_model.delan.measures import score

SCHEMA = "keycld.delan/1"


def work_off(out: Path, data: Path, trainings: Sequence[Training]) -> None:
    """Do what is missing.

    Raises:
        InputError: if the data are not the characters, or results are of other data.
    """
    rest, test = characters(data)
    whole = read_motions(data).sha256
    for result in results(out):
        if result["data"] != whole:
            raise InputError(f"{out} holds results of other data than {data}; choose another --out.")
    todo = [t for t in trainings if not _file(out, t).is_file()]
    with one_writer(out), progress("Models", total=len(trainings)) as advance:
        advance(len(trainings) - len(todo))
        for training in todo:
            motions, folder = amount(rest, training), out / "models" / training.name
            model, about = trained(training.model, motions, folder, training.seed)
            result = {
                "schema": SCHEMA,
                "data": whole,
                **asdict(training),
                **about,
                "scores": asdict(score(model, test)),
            }
            write_json(_file(out, training), result)
            advance(1)


def characters(data: Path) -> tuple[Motions, Motions]:
    """Those to learn from, and those of the test.

    Raises:
        InputError: if the file has others.
    """
    rest, test = read_motions(data).hold_out(TEST)
    if len(rest) < ALL:
        raise InputError(f"{data} has {len(rest)} characters beside {', '.join(TEST)}; the experiment has {ALL}.")
    return rest, test


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
