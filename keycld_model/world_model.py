"""`WorldModel`: keypoints, constrained Lagrangian and renderer, ready to use."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from keycld_envs.checks import check_whole
from keycld_envs.effects import Effect
from keycld_envs.effects.stored import effect_to_json, effects_from_json
from keycld_envs.errors import InputError
from keycld_model.arrays import actions_of, images_of, keypoints_of, sequences_of
from keycld_model.checkpoint import write_checkpoint
from keycld_model.intervals import Intervals, intervals
from keycld_model.learned_system import LearnedSystem
from keycld_model.modules import Parameters
from keycld_model.physics import mass_matrix
from keycld_model.stored import find_model, read_model
from keycld_model.uncertainty import Uncertainty

Floats = NDArray[np.float32]
CONTEXT_FRAMES = 5
"""Frames from which a prediction starts unless told otherwise."""


@dataclass(frozen=True)
class Prediction:
    """What a model expects to happen.

    Attributes:
        frames: [T, H, W, 3] float32, 0 to 1; frame 0 is the first given frame, as the model sees it.
        keypoints: [T, K, 2], image units.
        velocities: [T, K, 2], image units per second.
        samples: [n, T, K, 2], what else may happen, image units; None unless asked for.
    """

    frames: Floats
    keypoints: Floats
    velocities: Floats
    samples: Floats | None = None


@dataclass(frozen=True, eq=False)
class WorldModel(LearnedSystem):
    """A learned world model of one mechanism.

    Positions are in image units: pixel centres span -1 to 1, x to the right, y up. Time is in seconds. Forces and
    energies are per total mass: sum(masses) = 1 fixes the scale that motion alone leaves open.
    """

    @classmethod
    def load(cls, source: str | os.PathLike[str]) -> "WorldModel":
        """Load shipped weights by a system's name or its environment's id, or a checkpoint folder.

        Args:
            source: "pendulum", "cartpole", "acrobot", "KeyCLD/Acrobot-v0", ..., or the path of a checkpoint.

        Raises:
            InputError: if there is no such model, or it is damaged or of another version.
        """
        config, parameters, uncertainty, meta = read_model(find_model(os.fspath(source)))
        effects = effects_from_json(meta.get("effects", []), f"{source}: effects")
        return cls(config, parameters, os.fspath(source), meta, effects, uncertainty)

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write a checkpoint (safetensors and JSON) that `load` reads."""
        meta = {
            k: v for k, v in (self.meta or {}).items() if k not in ("schema", "sha256", "versions", "config", "effects")
        }
        if self.effects:
            meta["effects"] = [effect_to_json(effect) for effect in self.effects]
        tensors = {"model": self.parameters}
        if self.uncertainty is not None:
            tensors["uncertainty"] = self.uncertainty.tensors()
        return write_checkpoint(folder, tensors, {"config": self.config.to_dict(), **meta})

    def with_parameters(self, parameters: Parameters) -> "WorldModel":
        """The same architecture with other parameters, sharing what is compiled already."""
        other = replace(self, parameters=parameters, uncertainty=None)
        if not self.effects:  # which are reckoned for these parameters
            other.__dict__["_compiled"] = self._compiled
        return other

    def with_effects(self, effects: Sequence[Effect]) -> "WorldModel":
        """The same model with physics that it has not learned, in place of any that it had been given.

        Predictions, agents and checkpoints have it; weights stay as they are.

        Args:
            effects: of `keycld_envs.effects`: friction, springs and constant forces at joints, gain, saturation, dead
                zone, lag and delay of motors, tilt of gravity.

        Raises:
            InputError: if there is another effect, or one at no place of the system, or the model has no constraints.
        """
        other = replace(self, effects=tuple(effects))
        _ = other.added
        return other

    # The same for arrays with any leading dimensions ----------------------------------------------------------------

    def keypoints(self, images: ArrayLike) -> Floats:
        """Find the keypoints.

        Args:
            images: [..., H, W, 3], uint8, or float in 0 to 1.

        Returns:
            [..., K, 2], image units.

        Raises:
            InputError: if the images have another size or hold NaN.
        """
        return self._compiled.keypoints(self.parameters, images_of(images, self.image_shape))

    def render(self, x: ArrayLike) -> Floats:
        """Draw frames [..., H, W, 3] (0 to 1) of keypoints [..., K, 2], image units."""
        return self._of_keypoints("render", x)

    def potential_energy(self, x: ArrayLike) -> Floats:
        """V(x) of keypoints [..., K, 2], image units: [...], image units squared per second squared, per total mass."""
        return self._of_keypoints("potential_energy", x)

    def input_matrix(self, x: ArrayLike) -> Floats:
        """g(x) of keypoints [..., K, 2], image units: [..., 2K, m], image units per second squared, per unit of action.

        A force per total mass.
        """
        return self._of_keypoints("input_matrix", x)

    def mass_matrix(self) -> Floats:
        """M, [2K, 2K], diagonal, in units of the total mass, so of trace 2: every mass counts in x and in y."""
        return np.asarray(mass_matrix(self.mechanism, jnp.asarray(self.masses)))

    def constraint(self, x: ArrayLike) -> Floats:
        """Phi(x) - level of keypoints [..., K, 2], image units: [..., c], zero where the mechanism can be.

        Rods come first, in image units squared (half a squared length), then sliders, in image units.
        """
        return self._of_keypoints("constraint", x)

    def intervals(self, at: ArrayLike | None = None) -> Intervals:
        """90 % intervals of masses and lengths, and of V and g where they are asked for; see `Intervals`.

        Of what was learned, without effects that were added.

        Args:
            at: [N, K, 2] keypoints as the model sees them, image units; V counts from the first.

        Raises:
            InputError: if the model holds no uncertainties, or at has another shape.
        """
        x = None if at is None else keypoints_of(at, self.mechanism.num_keypoints)
        if x is not None and (x.ndim != 3 or not len(x)):
            raise InputError(f"at has shape {x.shape}; give positions of shape [N, K, 2], N at least 1.")
        return intervals(self.parts, self.parameters, self._known_uncertainty(), x)

    def _known_uncertainty(self) -> Uncertainty:
        if self.uncertainty is None:
            raise InputError(
                f"{self.name} holds no uncertainties; measure them on the recordings that it was trained on: "
                "`keycld intervals CHECKPOINT --data DATA --out WITH_THEM`."
            )
        return self.uncertainty

    def predict(self, images: ArrayLike, actions: ArrayLike, steps: int, samples: int = 0, seed: int = 0) -> Prediction:
        """Predict a sequence from its first frames.

        The state at the first frame is the least-squares fit of a trajectory of the model to all given frames, first to
        their keypoints, then to their pixels; the model then runs on its own.

        Args:
            images: [C, H, W, 3], the first C >= 2 frames, uint8 or float in 0 to 1.
            actions: [steps-1, m] or longer; action i acts between frames i and i+1, frame 0 being the first given one.
            steps: number of frames to predict, T; the first C of them are the given frames as the model sees them.
            samples: also follow so many trajectories of masses, lengths and forces as they may be, from initial states
                as they may be, given how far keypoints are off.
            seed: of these.

        Raises:
            InputError: if there are fewer than two frames, too few actions, or arrays of other sizes or with NaN; if
                samples are asked for and the model holds no uncertainties.
        """
        frames = images_of(images, self.image_shape)
        if frames.ndim != 4 or not len(frames) >= 2:
            raise InputError(f"images has shape {frames.shape}; a prediction starts from [C, H, W, 3], C at least 2.")
        if steps < len(frames):
            raise InputError(f"steps is {steps}, but {len(frames)} frames are given; ask for at least as many.")
        u = actions_of(actions, steps - 1, self.mechanism.num_actions)
        keypoints, velocities = self.rollout(frames[None], u[None])
        drawn = self._samples(keypoints[0], velocities[0], len(frames), u, samples, seed) if samples else None
        return Prediction(self.render(keypoints[0]), keypoints[0], velocities[0], drawn)

    def _samples(
        self, keypoints: Floats, velocities: Floats, context: int, actions: Floats, count: int, seed: int
    ) -> Floats:
        """`[count, T, K, 2]` around a prediction `[T, K, 2]`, the first C frames of which were given."""
        check_whole("samples", count, 1, 10**6)
        check_whole("seed", seed, 0, 2**63)
        uncertainty, rng = self._known_uncertainty(), np.random.default_rng(seed)
        numbers = uncertainty.draw(count, rng)
        seen = keypoints[:context].reshape(context, -1)
        seen = seen + uncertainty.keypoint_errors((count, *seen.shape), rng)
        u = actions if self.added is None else self.added.at_motors(actions).astype(np.float32)
        state = keypoints[0].ravel(), velocities[0].ravel()
        return self._compiled.sampled(self.parameters, numbers, state, seen, u).reshape(count, *keypoints.shape)

    def rollout(self, images: ArrayLike, actions: ArrayLike, refine: bool = True) -> tuple[Floats, Floats]:
        """Predict the keypoints of many sequences from their first frames.

        Args:
            images: [N, C, H, W, 3], C >= 2, uint8 or float in 0 to 1.
            actions: [N, T-1, m].
            refine: fit the initial state to the pixels, not only to the keypoints.

        Returns:
            Keypoints and velocities [N, T, K, 2], image units (per second).

        Raises:
            InputError: if the arrays do not fit together or the model, or hold NaN.
        """
        frames, u = sequences_of(images, actions, self.image_shape, self.mechanism.num_actions)
        if self.added is not None:
            u = np.stack([self.added.at_motors(one) for one in u]).astype(np.float32)
        states = [self._compiled.rollout(self.parameters, z, a, refine) for z, a in zip(frames, u, strict=True)]
        shape = (len(frames), u.shape[1] + 1, self.mechanism.num_keypoints, 2)
        x, v = (np.stack([np.asarray(s[i]) for s in states]).reshape(shape) for i in (0, 1))
        return x, v

    def _of_keypoints(self, name: str, x: ArrayLike) -> Floats:
        return self._compiled.of_keypoints(name, self.parameters, keypoints_of(x, self.mechanism.num_keypoints))
