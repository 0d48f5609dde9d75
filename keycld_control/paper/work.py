"""Trains, or loads, and measures; every piece of work leaves a file, so that nothing is done twice."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from keycld_control.paper.measures.angles import angle_table
from keycld_control.paper.measures.ceiling import ceiling
from keycld_control.paper.measures.energy import drift
from keycld_control.paper.measures.frames import beginning, curve, table_row
from keycld_control.paper.measures.long import FRAMES, beyond
from keycld_control.paper.measures.lyapunov import lyapunov
from keycld_control.paper.measures.masses import learned_masses
from keycld_control.paper.measures.memory import memory
from keycld_control.paper.measures.potential import potential
from keycld_control.paper.measures.speed import reference_step, speed
from keycld_control.paper.measures.starts import starts
from keycld_control.paper.plan import PAPER_VPT, WHOLE, Training
from keycld_control.paper.recordings import PARTS, VARIED, recordings
from keycld_control.paper.strips import write_strip, write_swing_up
from keycld_control.plain_json import write_json
from keycld_control.results import read_results
from keycld_envs import get_system, resolve_env_id, system_of
from keycld_envs.errors import InputError
from keycld_envs.files import one_writer
from keycld_envs.progress import progress
from keycld_envs.recordings import Dataset
from keycld_envs.workers import each
from keycld_model import WorldModel
from keycld_model.config import ModelConfig
from keycld_model.stored import shipped_models
from keycld_model.training import PRESETS, TrainingError, train

SCHEMA = "keycld.paper/4"


@dataclass(frozen=True)
class Work:
    """What all pieces of work share.

    Attributes:
        out: folder of the report; data, models and results lie in it.
        data_seed: of the paper's data set; tests have others.
        shipped: take the shipped weights where they are what is asked for.
    """

    out: Path
    data_seed: int = 1
    shipped: bool = True

    def result(self, training: Training) -> Path:
        """File of a training's figures."""
        return self.out / "results" / f"{training.name}.json"


def work_off(work: Work, trainings: Sequence[Training], workers: int = 1, ray: str | None = None) -> None:
    """Do what is missing, each training with its measures in one process."""
    for path, result in read_results(work.out, SCHEMA):
        if (seed := result.get("data_seed")) != work.data_seed:
            raise InputError(f"{path} is of --seed {seed}, not {work.data_seed}; choose another --out.")
    todo = [t for t in trainings if not work.result(t).is_file()]
    models = each(partial(one, work), todo, workers, ray)  # not begun, but a cluster that is not there shows here
    with one_writer(work.out):
        for training in todo:  # here, with all processes, before these need them
            for part in PARTS if training.is_default else ("test", "training"):
                recordings(work.out / "data", training.system, part, work.data_seed, workers)
        with progress("Models", total=len(trainings)) as advance:
            advance(len(trainings) - len(todo))
            for _ in models:
                advance(1)


def one(work: Work, training: Training) -> None:
    """Train or load one model, measure it, write the figures."""
    result: dict[str, Any] = {"schema": SCHEMA, "data_seed": work.data_seed, **asdict(training)}
    try:
        model, seconds = _model(work, training)
    except TrainingError as error:  # keypoints that collapse are a result, too
        write_json(work.result(training), result | {"failure": str(error)})
        return
    load = partial(recordings, work.out / "data", training.system, seed=work.data_seed)
    test = load("test")
    write_strip(work.out / "strips" / f"{training.name}.png", model, test)
    result |= {"training_s": seconds, "table": table_row(model, test), "curve": curve(model, test)}
    if model.config.networks.motion == "constrained":
        result["potential"] = potential(model, training.system)
        if all(mark.mass_position is not None for mark in get_system(training.system).landmarks):
            result["masses"] = learned_masses(model, training.system, result["potential"][0]["unit"])
    if training.is_default:
        result |= of_default(model, training.system, test, result["curve"]["errors"], load)
        result["swing_up"] = write_swing_up(work.out / "strips" / f"{training.name}-swing-up.png", model)
        wanted, log = PAPER_VPT["default"].get(training.system), work.out / "models" / training.name
        if seconds is not None and wanted is not None and log.is_dir():
            step = reference_step(training.system, load("training"))
            result["speed"] = speed(log, model.meta or {}, wanted, step)
    write_json(work.result(training), result)


def of_default(
    model: WorldModel, system: str, test: Dataset, errors: list[float], load: Callable[[str], Dataset]
) -> dict[str, Any]:
    """Figures that only the default's models have, from other data sets too; `errors` are those of the test's curve."""
    varying = {part: load(part) for part in VARIED}
    far, frames = load("long"), FRAMES[0]
    long = beyond(model, system, far)
    return {
        "angles": {part: angle_table(model, data, 50) for part, data in {"test": test, **varying}.items()},
        "varying": {part: curve(model, data) for part, data in varying.items()},
        "integrators": drift(model, test),
        "long": long,
        "lyapunov": lyapunov(system, beginning(far, frames), long["lengths"][f"{frames} frames"]["angle_valid"]),
        "ceiling": ceiling(system, beginning(far, frames)),
        "starts": starts(model, test),
        "memory": memory(model, load("training").split()[0], test, errors),
    }


def _model(work: Work, training: Training) -> tuple[WorldModel, float | None]:
    """The model, and how long its training took."""
    if (found := _loaded(work, training)) is not None:
        return found, (found.meta or {}).get("seconds")
    dataset = recordings(work.out / "data", training.system, "training", work.data_seed)
    dataset = replace(dataset, recordings=dataset.recordings[: training.recordings])
    preset, name = PRESETS[training.preset], resolve_env_id(training.system)
    config = ModelConfig.of(dataset, system_of(name).mechanism, name, preset.networks)
    result = train(dataset, config, work.out / "models" / training.name, training.preset, training.seed)
    return WorldModel.load(result.folder), result.seconds


def _loaded(work: Work, training: Training) -> WorldModel | None:
    """The shipped weights, if they were trained so."""
    if not work.shipped or training.system not in shipped_models() or training.sequences != WHOLE:
        return None
    model = WorldModel.load(training.system)
    meta = model.meta or {}
    made = meta.get("preset"), meta.get("seed"), meta.get("data", {}).get("seed")
    return model if made == (training.preset, training.seed, work.data_seed) else None


def results(out: Path) -> list[dict[str, Any]]:
    """All figures that are there, in order of their names.

    Raises:
        InputError: if a file is damaged or of another version.
    """
    return [result for _, result in read_results(out, SCHEMA)]
