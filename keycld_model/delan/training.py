"""Trains a joint model: resumes, logs, saves, stops when validation says so."""

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.files import one_writer
from keycld_envs.progress import Advance, progress
from keycld_model.checkpoint import STATE, check_same_run, read_checkpoint, write_checkpoint
from keycld_model.delan.config import JointConfig
from keycld_model.delan.families import JointDynamics
from keycld_model.delan.levenberg_marquardt import LeastSquaresProblem, Point, step
from keycld_model.delan.model import JointModel
from keycld_model.delan.motions import Floats, Motions
from keycld_model.delan.presets import PRESETS, Preset
from keycld_model.delan.residual import Residual, what_is_left
from keycld_model.delan.weights import repeated, torque_weights
from keycld_model.training import log
from keycld_model.training.folder import check_run_folder
from keycld_model.training.watch import Watcher

SAVE_EVERY = 10.0
"""Seconds between checkpoints of a running training."""
VALIDATION = 0.15
"""Share of the motions that say when to stop."""
BETTER = 0.99
"""Share of the best validation error below which another is better."""
ENOUGH = 1e-12
"""Validation error, as a share of the torques' variance, at which nothing is left to learn in practice."""


@dataclass(frozen=True)
class TrainingResult:
    """What a finished run reached.

    Attributes:
        model: the trained model.
        folder: the checkpoint.
        iterations: Levenberg-Marquardt steps in all.
        seconds: computing time of all sessions of the run.
        validation_error: mean squared error of held-out torques, each over its variance; of a residual, over the
            variance of what the base leaves.
    """

    model: JointModel
    folder: Path
    iterations: int
    seconds: float
    validation_error: float


def train(
    motions: Motions,
    out: str | os.PathLike[str],
    preset: str | Preset = "structured",
    friction: Sequence[str] = (),
    seed: int = 0,
    validation: float = VALIDATION,
    residual_of: JointModel | None = None,
    watchers: Sequence[Watcher] = (),
) -> TrainingResult:
    """Train a joint model; a run that was interrupted continues where it stopped, with the same result.

    Where velocities or accelerations were estimated, their uncertainty becomes one of torques by a first model, and a
    second fit weighs torques by it; networks' weights are held by a prior, see `levenberg_marquardt`.

    Args:
        motions: to learn from; some of them, drawn by the seed, only say when to stop.
        out: folder for the checkpoint, `log.jsonl`, and the state of an unfinished run (`state/`).
        preset: recipe, or its name.
        friction: ids of effects at every joint, of `keycld_model.delan.config.FRICTIONS`.
        seed: of the first weights and of the division.
        validation: share of the motions held out.
        residual_of: a model that stays as it is; what it leaves in the torques is learned, and the result is the sum of
            both. It needs equations of motion: a feed-forward network has none.
        watchers: told of every line of the log and every checkpoint.

    Raises:
        InputError: if the data do not fit, or `out` holds another run or anything else.
    """
    if isinstance(preset, str) and preset not in PRESETS:
        raise InputError(f"There is no preset {preset!r}; there are {', '.join(PRESETS)}.")
    recipe = PRESETS[preset] if isinstance(preset, str) else preset
    if seed < 0:
        raise InputError(f"seed is {seed}; it must not be negative.")
    check_run_folder(out)
    training, held_out = motions.split(validation, seed)
    own, residual = _configured(training, recipe, tuple(friction), residual_of)
    config = own if residual is None else residual.config
    meta = {
        "preset": asdict(recipe),
        "seed": seed,
        "validation": validation,
        "data": {"sha256": motions.sha256, "source": Path(motions.source).name, "motions": list(motions.ids)},
        "joint_model": config.to_dict(),
    } | ({} if residual is None else {"residual_of": residual.base_sha256})
    run = _Run(Path(out), own, residual, recipe, training, held_out, seed, json.loads(json.dumps(meta)), watchers)
    with one_writer(out):
        return run.finish()


def _configured(
    motions: Motions, recipe: Preset, friction: tuple[str, ...], residual_of: JointModel | None
) -> tuple[JointConfig, Residual | None]:
    """The model to be learned, and how it is added to another one, if it is."""
    scales = motions.scales()
    own = JointConfig(motions.joints, motions.kinds, scales, recipe.family, recipe.width, recipe.depth, friction)
    if residual_of is None:
        return own, None
    left = what_is_left(residual_of, motions).scales()
    return own, Residual(residual_of, replace(own, scales=replace(scales, torque=left.torque)), scales)


@dataclass
class _State:
    """Where a run is: a round has its own weights of the samples, which its first weights give."""

    point: Point
    best: Floats
    anchor: Floats
    round: int = 0
    iteration: int = 0
    error: float = float("inf")
    waited: int = 0
    seconds: float = 0.0
    finished: bool = False

    def numbers(self) -> dict[str, Any]:
        """What is no array, for JSON, which has no infinity."""
        out = {n: getattr(self, n) for n in ("round", "iteration", "error", "waited", "seconds", "finished")}
        out |= {
            "damping": self.point.damping,
            "prior": self.point.prior,
            "cost": self.point.cost,
            "stuck": self.point.stuck,
        }
        return {name: None if value == float("inf") else value for name, value in out.items()}

    @classmethod
    def of(cls, tensors: dict[str, Any], numbers: dict[str, Any]) -> "_State":
        """What was saved."""
        n: dict[str, Any] = {name: float("inf") if value is None else value for name, value in numbers.items()}
        point = Point(tensors["w"], n.pop("damping"), tuple(n.pop("prior")), n.pop("cost"), n.pop("stuck"))
        return cls(point, tensors["best"], tensors["anchor"], **n)


@dataclass
class _Run:
    folder: Path
    own: JointConfig
    residual: Residual | None
    preset: Preset
    training: Motions
    held_out: Motions
    seed: int
    meta: dict[str, Any]
    watchers: Sequence[Watcher] = ()

    def finish(self) -> TrainingResult:
        """Run or resume to the end."""
        config = self.own if self.residual is None else self.residual.config
        self.dynamics = JointDynamics(config)
        first = JointDynamics(self.own).initial(self.seed)
        with jax.enable_x64(True):
            flat, self._unflatten = ravel_pytree(jax.tree.map(jnp.asarray, first))
        state = self._resume(np.asarray(flat))
        rounds = 2 if self.training.all("a_std").any() else 1
        total = rounds * self.preset.iterations
        with progress("Training", total=total) as advance:
            while state.round < rounds:
                advance(state.round * self.preset.iterations + state.iteration)
                self._round(state, advance)
                state.round += 1
                if state.round < rounds:
                    state.point, state.anchor = Point(state.best), state.best
                    state.iteration, state.waited, state.error = 0, 0, float("inf")
                self._save(state)
        model = JointModel(config, self._parameters(state.best), self.meta | self._summary(state))
        if not state.finished:
            model.save(self.folder)
            state.finished = True
            self._save(state)
        steps = sum(1 for _ in log.entries(self.folder))
        return TrainingResult(model, self.folder, steps, state.seconds, state.error)

    def _summary(self, state: _State) -> dict[str, Any]:
        return {"seconds": round(state.seconds, 1), "validation_error": state.error}

    def _parameters(self, w: Floats) -> dict[str, Any]:
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, self._whole(jnp.asarray(w)))

    def _whole(self, w: jax.Array) -> dict[str, Any]:
        """The model's parameters, with those of the base."""
        own = self._unflatten(w)
        return own if self.residual is None else self.residual.parameters(own)

    def _resume(self, first: Floats) -> _State:
        if not (self.folder / STATE).exists():
            (self.folder / log.NAME).unlink(missing_ok=True)
            return _State(Point(first), first, first)
        tensors, meta = read_checkpoint(self.folder / STATE)
        check_same_run(self.folder, meta, self.meta)
        if {"w", "best", "anchor"} - set(tensors) or any(np.shape(x) != first.shape for x in tensors.values()):
            raise InputError(f"{self.folder / STATE} is damaged; remove the folder to begin anew.")
        state = _State.of(tensors, meta["position"])
        log.rewind(self.folder, state.round * self.preset.iterations + state.iteration)
        return state

    def _save(self, state: _State) -> None:
        tensors = {"w": state.point.w, "best": state.best, "anchor": state.anchor}
        write_checkpoint(self.folder / STATE, tensors, self.meta | {"position": state.numbers()})
        for watcher in self.watchers:
            watcher.saved(None, finished=state.finished)

    def _round(self, state: _State, advance: Advance) -> None:
        """Steps until validation has not become better for a while."""
        problem = self._problem(self.training, state)
        check = self._problem(self.held_out, state)
        last_save = time.perf_counter()
        while state.iteration < self.preset.iterations and state.waited < self.preset.patience:
            started = time.perf_counter()
            state.point = step(problem, state.point)
            error = check.cost(state.point.w)
            state.iteration += 1
            state.waited += 1
            if error < BETTER * state.error:
                state.waited = 0
            if error < state.error:
                state.best, state.error = state.point.w, error
            state.seconds += time.perf_counter() - started
            entry = {"step": state.round * self.preset.iterations + state.iteration, "round": state.round}
            entry |= {
                "loss": state.point.cost,
                "validation_error": error,
                "damping": state.point.damping,
                "prior": state.point.prior,
            }
            entry |= {"seconds": round(state.seconds, 2)}
            log.append(self.folder, entry)
            for watcher in self.watchers:
                watcher.logged(entry)
            advance(1, f"validation error {error:.3g}")
            if state.point.stuck or error < ENOUGH:
                return
            if time.perf_counter() - last_save > SAVE_EVERY:
                self._save(state)
                last_save = time.perf_counter()

    def _problem(self, motions: Motions, state: _State) -> LeastSquaresProblem:
        """Errors of the torques in units of their weights."""
        names = ("q", "v", "a", "tau", "v_std", "a_std")
        signals = [motions.all(name) for name in names]
        keep = np.unique(np.linspace(0, len(signals[0]) - 1, self.preset.samples).astype(int))
        q, v, a, tau, v_std, a_std = (signal[keep] for signal in signals)
        samples, std = (q, v, a, tau), (v_std, a_std)
        weights, repeats = np.broadcast_to(1 / np.array(self.own.scales.torque), q.shape), 1.0
        if state.round:
            anchor = self._parameters(state.anchor)
            weights = weights * torque_weights(self.dynamics, anchor, samples, std)
            repeats = repeated(self.dynamics, anchor, samples)
        groups = self._groups() if a_std.any() else np.full(len(state.best), -1)
        return LeastSquaresProblem(self._errors(), (*samples, np.array(weights)), groups, repeats)

    def _groups(self) -> NDArray[np.int_]:
        """Which weights have a prior of one width: those of one network, or of one linear part; -1 is friction."""
        first = JointDynamics(self.own).initial(self.seed)
        names: dict[str, int] = {}

        def group(path: tuple[Any, ...], x: Any) -> NDArray[np.int_]:
            keys = [str(k.key) for k in path]
            if keys[0] == "friction":
                return np.full(np.shape(x), -1)
            name = ".".join(k for k in keys if not k.startswith("layer_") and k not in ("kernel", "bias"))
            return np.full(np.shape(x), names.setdefault(name, len(names)))

        parts = jax.tree_util.tree_map_with_path(group, first)
        return np.concatenate([np.ravel(x) for x in jax.tree.leaves(parts)])

    def _errors(self) -> Callable[..., jax.Array]:
        def errors(w: jax.Array, q: jax.Array, v: jax.Array, a: jax.Array, tau: jax.Array, weight: jax.Array) -> Any:
            out = self.dynamics.prediction_errors(self._whole(w), q, v, a, tau)
            return out * jnp.tile(weight, len(out) // len(weight))

        return errors
