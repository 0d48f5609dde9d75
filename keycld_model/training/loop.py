"""Runs the stages, logs, saves, resumes."""

import json
import os
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from keycld_envs.errors import InputError
from keycld_envs.files import one_writer
from keycld_envs.progress import progress
from keycld_envs.recordings import Dataset
from keycld_model.checkpoint import STATE, check_same_run, read_checkpoint, write_checkpoint
from keycld_model.config import ModelConfig
from keycld_model.evaluation.valid_prediction_time import prediction_errors, static_error, valid_frames
from keycld_model.modules import Parameters, Parts
from keycld_model.training import log
from keycld_model.training.align import Align
from keycld_model.training.data import TrainingData, check_fits
from keycld_model.training.distil import Distil
from keycld_model.training.folder import check_run_folder
from keycld_model.training.presets import PRESETS, Preset
from keycld_model.training.relocate import spare_keypoint
from keycld_model.training.sharding import Devices
from keycld_model.training.stage import Stage, Variables, model_parameters
from keycld_model.training.step import make_step
from keycld_model.training.watch import Watcher
from keycld_model.world_model import WorldModel

LOG_EVERY = 100
SAVE_EVERY = 30.0
"""Seconds between checkpoints of a running stage."""
COLLAPSED = 0.01
"""Image units; keypoints that vary less over the recordings carry no motion."""
CHECK_EVERY = 500
"""Steps between looks at how much the keypoints vary."""
PLACES = ("rod_scale", "lean")
"""Variables that are not zero while masses lie elsewhere than the keypoints."""
SMALLER, TRIES = 0.25, 3
"""Factor on the learning rate each time that a stage which turned non-finite begins anew, and how often it does."""


class TrainingError(InputError):
    """Training cannot go on; the message says what to change. What was saved is intact."""


class _Diverged(TrainingError):
    """Something is no longer finite; smaller steps may help."""


@dataclass(frozen=True)
class TrainingResult:
    """What a finished run reached.

    Attributes:
        model: the trained world model.
        folder: the checkpoint.
        steps: optimiser steps of the recipe, with those of stages that were not needed.
        seconds: computing time of all sessions of the run.
        validation_vpt: mean valid prediction time on held-out recordings, fraction of the frames.
        spare: a keypoint that follows no part of its own, while a part has none; see `spare_keypoint`.
    """

    model: WorldModel
    folder: Path
    steps: int
    seconds: float
    validation_vpt: float
    spare: int | None


def train(
    dataset: Dataset,
    config: ModelConfig,
    out: str | os.PathLike[str],
    preset: str | Preset = "default",
    seed: int = 0,
    validation: float = 0.1,
    watchers: Sequence[Watcher] = (),
    start: Parameters | None = None,
    on_start: Callable[[], None] = lambda: None,
) -> TrainingResult:
    """Train a world model; a run that was interrupted continues where it stopped, with the same result.

    A stage whose loss or variables turn non-finite begins anew with a quarter of its learning rate, up to three times.

    Args:
        dataset: recordings; every tenth is held out for validation by default.
        config: mechanism, frame interval, image size, networks (`preset.networks` unless you change them).
        out: folder for the checkpoint, `log.jsonl`, and the state of an unfinished run (`state/`).
        preset: recipe, or its name.
        seed: of initialisation and batches.
        validation: fraction of recordings held out.
        watchers: told of every line of the log and every checkpoint.
        start: parameters to begin with, of a model that is to be tuned; its masses lie at its keypoints.
        on_start: called when everything has been checked, before the first step.

    Returns:
        The trained model and its score.

    Raises:
        InputError: if the data do not fit, or `out` holds another run or anything else.
        TrainingError: if the loss is not finite with smaller steps either, or the keypoints collapse to a constant.
    """
    name, recipe = _recipe(preset)
    if seed < 0:
        raise InputError(f"seed is {seed}; it must not be negative.")
    if not 0 < validation < 1:
        raise InputError(f"validation is {validation:g}; it must lie between 0 and 1.")
    check_run_folder(out)
    data, test = (TrainingData.from_dataset(part, recipe.length) for part in dataset.split(validation))
    check_fits(data, config, dataset)
    _check_pictures(config, name, recipe, start)
    meta = {
        "config": config.to_dict(),
        "preset": name,
        "length": recipe.length,
        "stages": [{"kind": type(s).__name__, **asdict(s)} for s in recipe.stages],
        "seed": seed,
        "validation": validation,
        "data": _origin(dataset),
    }
    plain = json.loads(json.dumps(meta))
    return _Run(Path(out), Parts(config), recipe, data, test, seed, plain, watchers, start, on_start).finish()


def _recipe(preset: str | Preset) -> tuple[str, Preset]:
    """Name and stages."""
    if isinstance(preset, Preset):
        return "custom", preset
    if preset not in PRESETS:
        raise InputError(f"There is no preset {preset!r}; there are {', '.join(PRESETS)}.")
    return preset, PRESETS[preset]


def _check_pictures(config: ModelConfig, name: str, recipe: Preset, start: Parameters | None) -> None:
    """Pictures of rigid parts are learned by a stage of their own.

    Raises:
        InputError: if only the configuration or only the recipe has them.
    """
    learned = any(isinstance(stage, Align) for stage in recipe.stages)
    if not (learned or start is not None) and any(isinstance(s, Distil) and s.composed for s in recipe.stages):
        raise InputError(
            f"A stage Distil of the recipe {name!r} has composed frames, but no stage Align, which learns the pictures "
            "that draw them; add one before it, or set composed to 0."
        )
    if config.networks.rigid_parts and not learned and start is None:
        raise InputError(
            f"networks.rigid_parts is True, but the recipe {name!r} has no stage Align, which learns their pictures; "
            "add one after the fits, or set networks.rigid_parts to False."
        )
    if learned and not config.networks.rigid_parts:
        raise InputError(
            f"The recipe {name!r} has a stage Align, but networks.rigid_parts is False; take the recipe's networks, or "
            "set networks.rigid_parts to True."
        )


def _origin(dataset: Dataset) -> dict[str, Any]:
    """By what a data set is known again."""
    return {
        "sha256": dataset.sha256,
        "folder": dataset.folder.name,
        "recordings": len(dataset),
        "seed": dataset.recordings[0].seed,
    }


@dataclass
class _Run:
    folder: Path
    parts: Parts
    preset: Preset
    data: TrainingData
    test: TrainingData
    seed: int
    meta: dict[str, Any]
    watchers: Sequence[Watcher] = ()
    start: Parameters | None = None
    on_start: Callable[[], None] = lambda: None
    devices: Devices = field(default_factory=Devices)
    smaller: int = 0
    """Times that the stage at hand has begun anew."""

    def finish(self) -> TrainingResult:
        """Run or resume to the end; of several processes, the first one writes."""
        with one_writer(self.folder) if self.devices.first else nullcontext():
            return self._finish()

    def _finish(self) -> TrainingResult:
        stage, done, seconds, variables, optimiser = self._resume()
        self.on_start()
        self._epsilon = static_error(self.data.frames)
        self._model = WorldModel(self.parts.config, model_parameters(variables))
        total = sum(s.steps for s in self.preset.stages[:stage]) + done
        with progress("Training", total=self.preset.steps) as advance:
            advance(total)
            for index in range(stage, len(self.preset.stages)):
                started = time.perf_counter()
                if done == 0 and not self.preset.stages[index].needed(self.parts, variables, self.data):
                    advance(self.preset.stages[index].steps)
                    continue
                variables = self._finite_stage(index, done, seconds, variables, optimiser, advance)
                done, optimiser, self.smaller = 0, None, 0
                score = self._score(variables)
                seconds += time.perf_counter() - started
                step = sum(s.steps for s in self.preset.stages[: index + 1])
                name = self.preset.stages[index].name
                self._log({"step": step, "stage": name, "validation_vpt": score, "seconds": seconds})
                advance(0, f"{name}: validation VPT {score:.2f}")
                self._save(index + 1, 0, seconds, variables, None)
        if away := [name for name in PLACES if np.any(np.asarray(variables.get(name, 0)))]:
            raise TrainingError(
                f"The recipe {self.meta['preset']!r} ends with masses that lie elsewhere than the keypoints "
                f"({' and '.join(away)} are not zero); end it with a stage Distil."
            )
        started = time.perf_counter()
        score = self._score(variables, refine=True)
        spare = spare_keypoint(self.parts, variables, self.data)
        seconds += time.perf_counter() - started
        summary = {"seconds": round(seconds, 1), "steps": self.preset.steps, "validation_vpt": score}
        model = WorldModel(
            self.parts.config,
            model_parameters(variables),
            str(self.folder),
            {**self.meta, **summary, "epsilon": self._epsilon},
        )
        if self.devices.first:
            model.save(self.folder)
            self._show(model, finished=True)
        return TrainingResult(model, self.folder, self.preset.steps, seconds, score, spare)

    def _resume(self) -> tuple[int, int, float, Variables, Any]:
        if not (self.folder / STATE).exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            if self.devices.first:
                (self.folder / log.NAME).unlink(missing_ok=True)
            return 0, 0, 0.0, jax.tree.map(jnp.asarray, self._first()), None
        tensors, meta = read_checkpoint(self.folder / STATE)
        check_same_run(self.folder, meta, self.meta)
        stage, done = meta.get("stage", -1), meta.get("done", -1)
        places = {(i, k) for i, s in enumerate(self.preset.stages) for k in range(s.steps + 1)}
        if (stage, done) not in places | {(len(self.preset.stages), 0)} or "variables" not in tensors:
            raise InputError(
                f"{self.folder / STATE} is at step {done} of stage {stage}, which this recipe has not; remove the "
                "folder to begin anew."
            )
        if self.devices.first:
            log.rewind(self.folder, meta["step"])
        self.smaller = int(meta.get("smaller", 0))
        variables = jax.tree.map(jnp.asarray, tensors["variables"])
        return int(stage), int(done), meta["seconds"], variables, tensors.get("optimiser")

    def _first(self) -> Variables:
        """What training starts from."""
        if self.start is None:
            return self.parts.initial(self.seed)
        there = np.zeros(self.parts.config.mechanism.num_keypoints, np.float32)
        return {**self.start, **dict.fromkeys(PLACES, there)}

    def _log(self, entry: dict[str, Any]) -> None:
        if self.devices.first:
            log.append(self.folder, entry)
            for watcher in self.watchers:
                watcher.logged(entry)

    def _save(self, stage: int, done: int, seconds: float, variables: Variables, optimiser: Any) -> None:
        if not self.devices.first:
            return
        tensors = {"variables": variables}
        if optimiser is not None:
            tensors["optimiser"] = {f"{i:04d}": leaf for i, leaf in enumerate(jax.tree.leaves(optimiser))}
        step = sum(s.steps for s in self.preset.stages[:stage]) + done
        position = {"stage": stage, "done": done, "step": step, "seconds": seconds, "smaller": self.smaller}
        write_checkpoint(self.folder / STATE, tensors, {**self.meta, **position})
        here = jax.tree.map(np.asarray, model_parameters(variables))  # what one process may reckon with alone
        self._show(self._model.with_parameters(here), finished=False)

    def _show(self, model: WorldModel, *, finished: bool) -> None:
        for watcher in self.watchers:
            watcher.saved(model, finished=finished)

    def _finite_stage(
        self, index: int, done: int, seconds: float, variables: Variables, saved: Any, advance: Callable[..., None]
    ) -> Variables:
        """Run a stage from where it stands; with smaller steps if it turns non-finite."""
        step = sum(s.steps for s in self.preset.stages[:index]) + done
        while True:
            try:
                return self._stage(index, done, seconds, variables, saved, advance)
            except _Diverged:
                if self.smaller == TRIES:
                    raise
                self.smaller += 1
                if self.devices.first:
                    log.rewind(self.folder, step)
                self._log({"step": step, "stage": self.preset.stages[index].name, "smaller_steps": self.smaller})

    def _stage(
        self, index: int, done: int, seconds: float, variables: Variables, saved: Any, advance: Callable[..., None]
    ) -> Variables:
        stage, started = self.preset.stages[index], time.perf_counter()
        stage = replace(stage, learning_rate=stage.learning_rate * SMALLER**self.smaller)
        if saved is None:
            variables = stage.enter(self.parts, variables, self.data)
        context = stage.prepare(self.parts, variables, self.data)
        trained = {key: variables[key] for key in stage.trained}
        frozen = {key: value for key, value in variables.items() if key not in trained}
        optimiser = stage.optimiser()
        state = optimiser.init(trained)
        if saved is not None:
            leaves = [jnp.asarray(saved[key]) for key in sorted(saved)]
            state = jax.tree.unflatten(jax.tree.structure(state), leaves)
        step = make_step(self.parts, stage, optimiser, self.devices)
        trained, frozen, state = map(self.devices.replicate, (trained, frozen, state))
        before = sum(s.steps for s in self.preset.stages[:index])
        always = sum(not s.optional for s in self.preset.stages[:index])
        key = (self.seed, always, index) if stage.optional else (self.seed, always)
        last_save = time.perf_counter()
        for i in range(done, stage.steps):
            batch = stage.draw(context, self.data, np.random.default_rng((*key, i)))
            trained, state, metrics = step(trained, frozen, state, self.devices.divide(batch))
            advance(1)
            last = i + 1 == stage.steps
            if (i + 1) % LOG_EVERY == 0 or last:
                entry = self._metrics(stage, i + 1, metrics, trained)
                if "estimator" in trained and ((i + 1) % CHECK_EVERY == 0 or last):
                    self._check_motion(stage, i + 1, self.devices.gather({**frozen, **trained}))
                elapsed = round(seconds + time.perf_counter() - started, 2)
                self._log({"step": before + i + 1, "stage": stage.name, **entry, "seconds": elapsed})
                advance(0, f"{stage.name}: loss {entry['loss']:.4g}")
                if time.perf_counter() - last_save > SAVE_EVERY and not last:  # the end of a stage is saved anyway
                    self._save(index, i + 1, elapsed, {**frozen, **trained}, state)
                    last_save = time.perf_counter()
        return stage.leave(self.parts, self.devices.gather({**frozen, **trained}), self.data)

    def _metrics(self, stage: Stage, done: int, metrics: dict[str, Any], trained: Variables) -> dict[str, Any]:
        """Plain numbers; refuses losses and variables that are not finite (one step apart, as a rule)."""
        numbers = {key: np.asarray(value) for key, value in metrics.items()}
        leaves = [numbers["loss"], *jax.tree.leaves(trained)]
        if not all(np.isfinite(leaf).all() for leaf in leaves):
            raise _Diverged(
                f"The loss or what is learned is not finite in stage {stage.name!r} at step {done} of {stage.steps}, "
                f"with a learning rate of {stage.learning_rate:g} either; try --learning-rate-scale 0.1 or another "
                f"--seed ({self.folder / STATE} holds the last good state)."
            )
        return {key: value.round(6).tolist() for key, value in numbers.items()}

    def _check_motion(self, stage: Stage, done: int, variables: Variables) -> None:
        """Refuse keypoints that stay where they are, all over the recordings; in one sequence they may."""
        sample = self.data.flat_frames[self.data.spread(64)]
        spread = self._model.with_parameters(model_parameters(variables)).keypoints(sample).std(axis=0).max(axis=-1)
        if (spread < COLLAPSED).any():
            raise TrainingError(
                f"Keypoint {int(spread.argmin())} has collapsed to a constant in stage {stage.name!r} at step {done} "
                f"of {stage.steps} (it varies by {spread.min():.4f} image units); check that every declared keypoint "
                "moves in the recordings, or try another --seed."
            )

    def _score(self, variables: Variables, refine: bool = False) -> float:
        """Mean fraction of valid frames on held-out sequences; nan before there is a dynamics model of what is seen.

        Until distillation, masses may lie elsewhere than the keypoints.
        """
        unknown = "trajectories" not in variables and not np.any(np.asarray(variables["dynamics"]["level"]))
        if unknown or any(np.any(np.asarray(variables.get(name, 0))) for name in PLACES):
            return float("nan")
        model = self._model.with_parameters(model_parameters(variables))
        errors = prediction_errors(model, self.test.frames, self.test.actions, refine=refine)
        return float(np.mean(valid_frames(errors, self._epsilon)) / self.test.length)
