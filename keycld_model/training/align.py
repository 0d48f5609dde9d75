"""Learn what the rigid parts look like, and put keypoints where these pictures fit the frames best."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_model.aligned_keypoints import SAMPLE, align, colours, distances, drawing, near
from keycld_model.modules import Parts
from keycld_model.nets.rigid_parts import COVERED, SOFT
from keycld_model.numerics import evenly_spaced
from keycld_model.places import beside, to_masses
from keycld_model.training.data import TrainingData
from keycld_model.training.keypoint_tables import TRUSTED, keypoint_table, trajectories, trust
from keycld_model.training.stage import Batch, Context, Stage, Variables

RING = 0.015
"""Steps in which distances from the parts are looked at, image units (half of one of 64 pixels)."""
FAINT = 0.01
"""Share of the most that differs from the still scene at any distance, below which parts end; shadows and reflections
differ, too, farther away."""
REACHES = (0.06, 0.3)
"""Least and greatest reach of a part beyond its rod, image units."""
OFFSET = 0.1
"""Image units by which an offset of one moves a joint: the optimiser's steps are a twentieth of a pixel at most."""
LEAST_SPREAD = 0.001
"""Image units by which trajectories are thought to be off, at least."""


@dataclass(frozen=True, kw_only=True)
class Align(Stage):
    """Learn what parts look like, then find every keypoint again where these pictures fit its frame.

    A keypoint beside a joint, with all after it as far beside, keeps all rods rigid; but then the next part turns about
    a point off its own picture, which blurs it. So frames tell where joints are. Later stages fit these keypoints in
    place of the estimator's.

    Attributes:
        share: of the frames that teach what parts look like, those that are aligned; all others, too, if it is 1.
    """

    name: str = "align"
    share: float = 1.0
    trained: tuple[str, ...] = ("appearance", "offsets")

    def enter(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Begin with keypoints on their trajectories, as measured where those are lost; later, with what was found."""
        offsets = jnp.zeros((parts.config.mechanism.num_keypoints, 2))
        if "aligned" in variables:
            return {**variables, "offsets": offsets}
        positions = trajectories(parts, variables, data)
        trusted = trust(parts, variables, data, positions)
        measured = to_masses(parts.config.mechanism, variables, jnp.asarray(keypoint_table(parts, variables, data)))
        spread = _spread(positions - np.asarray(measured), trusted)
        positions = np.where(trusted[..., None] > TRUSTED, positions, np.asarray(measured))
        known = _trusted(trusted)
        known = known[evenly_spaced(len(known), SAMPLE)]
        still = np.median(data.flat_frames[data.spread(SAMPLE)], axis=0) / 255.0
        appearance = {**variables["appearance"], "background": jnp.asarray(still, jnp.float32)}
        frames = data.flat_frames[known].astype(np.float32) / 255.0
        appearance["reach"] = _reach(parts, {**variables, "appearance": appearance}, frames, _flat(positions)[known])
        aligned, trusted = jnp.asarray(positions), jnp.asarray(trusted, jnp.float32)
        found = {"aligned": aligned, "trust": trusted, "spread": spread, "offsets": offsets}
        return {**variables, "appearance": appearance, **found}

    def prepare(self, parts: Parts, variables: Variables, data: TrainingData) -> Context:
        """The frames that count, positions `[B, n]` in them, and the pixels `[B, M]` near the parts."""
        trusted = _trusted(np.asarray(variables["trust"]))
        positions = _flat(np.asarray(variables["aligned"]))[trusted]
        return {"frames": trusted, "positions": positions, "pixels": near(parts, variables, positions)}

    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """Frames from anywhere, near the parts."""
        i = rng.choice(len(context["frames"]), self.batch)
        pixels = context["pixels"][i]
        seen = colours(data.flat_frames[context["frames"][i]], pixels)
        return {"positions": context["positions"][i], "pixels": pixels, "seen": seen}

    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Squared error per frame."""
        positions = _joined(parts, variables, batch["positions"])
        drawn = jax.vmap(drawing(parts, variables))(positions, batch["pixels"])
        loss = jnp.mean(jnp.sum((drawn - batch["seen"]) ** 2, axis=(1, 2)))
        return loss, {"reconstruction": loss}

    def leave(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Align frames; the keypoints are where the masses are, now. Those that are not aligned teach no longer."""
        begun, trust = np.asarray(variables["aligned"]), np.asarray(variables["trust"])
        joined = np.asarray(jax.jit(partial(_joined, parts, variables))(jnp.asarray(_flat(begun))))
        rows = np.arange(trust.size) if self.share == 1 else _trusted(trust)[:: round(1 / self.share)]
        aligned, kept = joined.copy(), np.zeros(trust.size, np.float32)
        spread = np.repeat(np.asarray(variables["spread"]), 2)
        aligned[rows] = align(parts, variables, data.flat_frames[rows], joined[rows], spread)
        kept[rows] = trust.ravel()[rows]
        there = jnp.zeros_like(variables["rod_scale"])
        found = {"aligned": jnp.asarray(aligned.reshape(begun.shape)), "trust": jnp.asarray(kept.reshape(trust.shape))}
        rest = {name: value for name, value in variables.items() if name != "offsets"}
        return {**rest, **found, "rod_scale": there, "lean": there}


def _spread(error: NDArray[np.floating], trusted: NDArray[np.floating]) -> Array:
    """`[K]` by how much trajectories are off: standard deviations of what measured keypoints differ from them by."""
    error = error[trusted > TRUSTED] if (trusted > TRUSTED).any() else error.reshape(-1, error.shape[-1])
    middle = np.median(np.abs(error - np.median(error, 0)), 0).reshape(-1, 2) / 0.6745
    return jnp.asarray(np.maximum(np.sqrt((middle**2).mean(1)), LEAST_SPREAD), jnp.float32)


def _joined(parts: Parts, variables: Variables, positions: Array) -> Array:
    """`[B, n]` positions with joints where pictures say they are."""
    pivot, offsets = jax.lax.stop_gradient(variables["dynamics"]["pivot"]), OFFSET * variables["offsets"]
    return jax.vmap(lambda x: beside(parts.config.mechanism, pivot, offsets, x))(positions)


def _flat(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """`[N*T, n]` of `[N, T, n]`."""
    return positions.reshape(-1, positions.shape[-1])


def _trusted(trust: NDArray[np.floating]) -> NDArray[np.int64]:
    """Numbers of the frames that count; all, where none would."""
    chosen = np.flatnonzero(trust.ravel() > TRUSTED)
    return chosen if len(chosen) else np.arange(trust.size)


def _reach(parts: Parts, variables: Variables, frames: NDArray[np.float32], positions: NDArray[np.float32]) -> Array:
    """Distance from the parts beyond which hardly anything differs from the still scene."""
    still = np.asarray(variables["appearance"]["background"])
    differs = ((frames - still) ** 2).sum(-1).reshape(len(frames), -1)
    differs = np.maximum(differs - 9 * np.median(differs), 0)  # the median is the noise's
    every = distances(parts, variables, positions)
    covered = np.sort(every, axis=1)[:, every.shape[1] // COVERED - 1].min() - 2 * SOFT
    rings = (every / RING).astype(int).ravel()
    shares = np.bincount(rings, differs.ravel()) / np.maximum(np.bincount(rings), 1)
    shares = shares[: round(REACHES[1] / RING)]
    brightest = int(shares.argmax())
    faint = brightest + np.flatnonzero(shares[brightest:] < FAINT * shares[brightest])
    found = RING * faint[0] if len(faint) else REACHES[1]
    return jnp.asarray(min(np.clip(found, *REACHES), covered), jnp.float32)
