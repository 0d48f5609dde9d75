"""Joint positions of recordings, read off their frames by a world model's estimator."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs import system_of
from keycld_envs.errors import InputError
from keycld_envs.progress import progress
from keycld_envs.recordings import Recording
from keycld_model.camera import GREY, Camera, restore
from keycld_model.image_alignment import Positions
from keycld_model.image_alignment.films import frame_times
from keycld_model.image_alignment.pose import TRUSTED, explained_share
from keycld_model.joints import wrapped
from keycld_model.learned_mjcf import LearnedMjcf, places_of
from keycld_model.turns import on_common_turns
from keycld_model.world_model import WorldModel

Floats = NDArray[np.float64]
STILLS = 60
"""Frames of all recordings, whose median is the scene without the mechanism."""
SAME = 0.25
"""Grey levels by which that scene differs from the model's in the median, at most, if the camera is the same. The
pendulum's own differs by .01, moved by a pixel it differs by 1."""


def learned_positions(recordings: Sequence[Recording], model: WorldModel, document: LearnedMjcf) -> Positions:
    """Joint positions of a world model's document at the times of frames.

    No simulator is drawn: the estimator finds the keypoints, and the constraints tell the joints. Frames of a camera
    that is off by a few pixels, or of another light, are brought to the model's, see `keycld_model.camera`. A frame is
    trusted if the model's own picture of these keypoints explains most of what moves in it. The error is that of
    reading the model's pictures again.

    Args:
        recordings: with frames as the model was trained on.
        model: that reads them.
        document: its mechanism, see `learned_mjcf`.

    Raises:
        InputError: if frames are missing or of another size.
    """
    films = _as_the_model_sees([_frames(recording, model) for recording in recordings], model)
    still = np.median(_some(films), axis=0).astype(np.float32)
    places, early = places_of(model, document), _early(model)
    turns = document.model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    read, explained, again = [], [], []
    with progress("Reading positions off images", total=sum(map(len, films))) as advance:
        for film in films:
            keypoints = model.keypoints(film)
            q, drawn = np.asarray(places(keypoints), np.float64), model.render(keypoints)
            shares = np.array(
                [explained_share(f.astype(np.float32), 255 * d, still) for f, d in zip(film, drawn, strict=True)]
            )
            readable = shares >= TRUSTED
            error = places(model.keypoints(drawn.clip(0.0, 1.0))) - q
            again.append(np.where(turns, wrapped(error), error)[readable])
            explained.append(shares)
            q[~readable] = np.nan
            for j in np.flatnonzero(turns):  # they go on from frame to frame
                q[readable, j] = np.unwrap(q[readable, j])
            read.append(q)
            advance(len(film))
    out = [
        _with_positions(recording, document, q, turns, early)
        for recording, q in zip(recordings, on_common_turns(read, turns), strict=True)
    ]
    errors = np.concatenate(again)
    error = np.sqrt(np.mean(errors**2, axis=0)) if len(errors) else np.full(len(turns), np.nan)
    return Positions(
        recordings=tuple(out),
        deviation=tuple(np.broadcast_to(error, q.shape) for q in read),
        explained=tuple(explained),
        readable=tuple(shares >= TRUSTED for shares in explained),
        parameters=(),
        values=np.zeros(0),
        value_deviation=np.zeros(0),
        camera="front",
        size=model.image_shape,
        error=error,
        errors=tuple(np.broadcast_to(error, q.shape) for q in read),
        together=np.ones(len(turns)),
    )


def _some(films: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Frames of all films."""
    return np.concatenate([film[:: max(1, len(film) * len(films) // STILLS)] for film in films])


def _as_the_model_sees(films: list[NDArray[np.uint8]], model: WorldModel) -> list[NDArray[np.uint8]]:
    """Films of the model's own camera and light; of all films, one camera is told from the scene at rest."""
    some = _some(films)
    drawn = np.asarray(model.render(model.keypoints(some)), np.float32).clip(0.0, 1.0)
    background = np.median(drawn, axis=0)
    camera = Camera.find(background, np.median(some, axis=0).astype(np.float32) / 255, SAME * GREY)
    if camera is None:
        return films
    restoration = camera.restoration(drawn)
    if not restoration.changed:
        return films
    seen = jax.jit(jax.vmap(partial(restore, restoration, jnp.asarray(background))))
    return [(255 * np.asarray(seen(film)).clip(0.0, 1.0)).round().astype(np.uint8) for film in films]


def _frames(recording: Recording, model: WorldModel) -> NDArray[np.uint8]:
    """`[T, H, W, 3]`."""
    height, width = model.image_shape
    frame_times(recording)
    film = np.stack(list(recording.iter_frames()))
    if film.shape[1:3] != (height, width):
        raise InputError(
            f"Recording {recording.id!r} has frames of {film.shape[2]}×{film.shape[1]} pixels, the model {model.name} "
            f"sees {width}×{height}; record with its size, or train a model on recordings of this one."
        )
    return film


def _early(model: WorldModel) -> float:
    """Seconds by which commands act before their time in simulations of a model's system.

    With Euler's steps, a simulation moves as if each command had come half a step early, since positions go on with the
    velocity at the end of the step; what the model has learned is the motion between.
    """
    if model.system is None:
        return 0.0
    option = system_of(model.system).compile().opt
    return 0.0 if option.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 0.5 * float(option.timestep)


def _with_positions(
    recording: Recording, document: LearnedMjcf, q: Floats, turns: NDArray[np.bool_], early: float
) -> Recording:
    """The recording with positions in place of any that it has."""
    if recording.t_action is not None and recording.source == "simulation":
        recording = replace(recording, t_action=recording.t_action - early)
    length = "m" if document.units.of_system else "1"
    units = {key: unit for key, unit in recording.units.items() if key != "qvel"}
    return replace(
        recording,
        joint_names=document.joints,
        t_state=np.asarray(recording.t_frame, np.float64),
        qpos=q,
        qvel=None,
        qpos_std=None,
        units={**units, "qpos": tuple("rad" if turn else length for turn in turns)},
    )
