"""Joint positions of recordings from their frames alone."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.checks import MOST_WORKERS, check_whole, the_camera
from keycld_envs.errors import InputError
from keycld_envs.progress import progress
from keycld_envs.recordings import Recording
from keycld_envs.rendering import Quality
from keycld_envs.workers import each
from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.calibration import (
    MOST_ASTRAY,
    ErrorModel,
    ReadAgain,
    fit_variance_of,
    frames_together,
    read_astray,
    reading_error,
    unexplained_by,
)
from keycld_model.image_alignment.chroma import HalvedChroma
from keycld_model.image_alignment.films import Films, read_films
from keycld_model.image_alignment.fit_look import STEPS, UNSEEN, Look, find_pose, fit_look
from keycld_model.image_alignment.follow import follow, turning
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.look import LookParameter
from keycld_model.image_alignment.look_errors import Change, LookErrors, change_by_look
from keycld_model.image_alignment.pose import Pose
from keycld_model.image_alignment.scene import Scene
from keycld_model.image_alignment.surroundings import Surroundings
from keycld_model.turns import on_common_turns

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Job = tuple[Light, Array, NDArray[np.uint8]]
FRAMES = 18
"""Frames that the look is fitted to."""
TESTED = 6
"""Recordings of which some frames are drawn and read again, for their error."""
CHANGED = 8
"""Frames of a recording, or a few more, that tell what errors of the look do to positions."""


@dataclass(frozen=True)
class Positions:
    """What was read off the frames of recordings.

    Attributes:
        recordings: with joint positions at the times of their frames, NaN where a frame does not tell.
        deviation: of each recording, `[T, nq]` standard deviations by the fits' curvature, rad or m.
        explained: of each recording, `[T]` the share of a frame's motion that its pose explains.
        readable: of each recording, `[T]` whether positions could be read off a frame.
        parameters: of the look.
        values: `[p]` of them.
        value_deviation: `[p]` their standard deviations.
        camera: that looked.
        size: of the images that were aligned, (H, W).
        error: `[nq]` root mean square error of the positions, rad or m, from frames drawn at known positions.
        errors: of each recording, `[T, nq]` standard deviations of each frame's error, from the same.
        together: `[nq]` number of frames over which errors are correlated, one if they are not.
        astray: share of frames drawn at known positions that are read elsewhere; if it is more than `MOST_ASTRAY`, no
            frame is readable.
        by_look: how far they are off where the look is; None where none was fitted, or no frame tells positions.
        repeated: number of frames that were left out, because they show an earlier one again.
        out_of_view: of each recording, `[T]` whether the mechanism has left the image; none has where it is empty.
    """

    recordings: tuple[Recording, ...]
    deviation: tuple[Array, ...]
    explained: tuple[Array, ...]
    readable: tuple[NDArray[np.bool_], ...]
    parameters: tuple[LookParameter, ...]
    values: Array
    value_deviation: Array
    camera: str
    size: tuple[int, int]
    error: Array
    errors: tuple[Array, ...]
    together: Array
    astray: float = 0.0
    by_look: LookErrors | None = None
    repeated: int = 0
    out_of_view: tuple[NDArray[np.bool_], ...] = ()

    @property
    def read(self) -> float:
        """Share of all frames whose positions may be used."""
        return float(np.mean(np.concatenate(self.readable)))

    @property
    def trusted(self) -> float:
        """The same of those that the mechanism has not left."""
        if not self.out_of_view:
            return self.read
        readable = np.concatenate(self.readable)
        shown = readable | ~np.concatenate(self.out_of_view)
        return float(readable.sum() / max(1, shown.sum()))


def read_positions(
    recordings: Sequence[Recording], model: mujoco.MjModel, camera: str | None = None, workers: int = 2
) -> Positions:
    """Read joint positions off frames: a simulator is drawn, and moved until its picture is that of each frame.

    Neither sensors nor a learned model are needed. The camera's shift, zoom, aspect, roll, pitch and yaw, where it
    stands, the visible lengths of links, blur, and the brightness of each recording are fitted to frames of all
    recordings first.

    Args:
        recordings: with frames; joint positions that they have are not looked at.
        model: the simulator, with a camera.
        camera: its name; by default the one that the recordings name, or the model's only one.
        workers: processes.

    Raises:
        InputError: if a recording has no frames, or they have several sizes, or the model has no such camera, or no
            OpenGL can be opened.
    """
    check_whole("workers", workers, 1, MOST_WORKERS)
    films = read_films(recordings)
    quality: Quality = "full" if recordings[0].render_quality == "full" else "fast"
    name = _camera(recordings, model, camera)
    with progress("Reading positions off images", total=films.number + 300) as advance:
        with Scene(model, name, films.size, quality, films.halved) as scene:
            stills = [np.median(f[:: max(1, len(f) // 60)], axis=0).astype(np.float32) for f in films.frames]
            bank = Bank(scene, scene.nominal)
            advance(100)
            around = Surroundings.of(films.frames)
            look = fit_look(scene, stills, films.spread(FRAMES), bank, around, partial(advance, 200 // STEPS))
            reader = _Reader(model, name, quality, films.halved, look.values, look.bank)
            parameters = scene.parameters
            seen = look.seen or _shown(scene, look, films, stills)
        jobs = list(zip(look.lights, films.times, films.frames, strict=True))
        followed, changes = [], []
        for poses, of_look in each(reader.follow, jobs, min(workers, len(jobs))) if seen else _unseen(look, films):
            followed.append(poses)
            changes += of_look
            advance(len(poses))
        spread = _spread(followed)
        places = np.linspace(0, 1, len(spread))  # released mechanisms are slow at first
        tested = [(jobs[r], followed[r], since) for r, since in zip(spread, places, strict=True)]
        again = list(each(reader.error, tested, min(workers, len(tested))))
    by_look = LookErrors.of(parameters, look.deviation, turning(model), changes) if changes else None
    return _positions(recordings, model, films, followed, look, parameters, name, again, by_look)


def _shown(scene: Scene, look: Look, films: Films, stills: Sequence[Image]) -> bool:
    """Whether a recording shows the mechanism in the frame that differs most from what is still."""
    for frames, still, light in zip(films.frames, stills, look.lights, strict=True):
        most = max(frames, key=lambda frame: float(np.abs(frame - still).mean())).astype(np.float32)
        pose = find_pose(scene, look.values, light, most, look.bank, light.apply(look.bank.still))
        if pose.explained > UNSEEN:
            return True
    return False


def _unseen(look: Look, films: Films) -> Iterator[tuple[list[Pose], list[Change]]]:
    """A pose that tells nothing for every frame, of recordings that show something else."""
    for pose, frames in zip(look.best, films.frames, strict=True):
        yield [pose] * len(frames), []


def _spread(followed: Sequence[Sequence[Pose]]) -> NDArray[np.intp]:
    """Indices of some recordings, of all speeds: how far all joints go from frame to frame, on average, rad or m."""
    speeds = [float(np.mean(np.abs(np.diff([pose.q for pose in poses], axis=0)))) for poses in followed]
    number = min(TESTED, len(speeds))
    return np.argsort(speeds)[((np.arange(number) + 0.5) * len(speeds) / number).astype(int)]


@dataclass(frozen=True)
class _Reader:
    """Reads recordings with a look that is known, in any process; a job is the light, times and frames of one."""

    model: mujoco.MjModel
    camera: str
    quality: Quality
    halved: HalvedChroma | None
    look: Array
    bank: Bank

    def follow(self, job: Job) -> tuple[list[Pose], list[Change]]:
        """Poses of all frames, and what the look changes at some of them."""
        with self._scene(job) as scene:
            poses = follow(scene, self.look, *job, self.bank)
            known = [pose.q for pose in poses if pose.readable]
            return poses, [change_by_look(scene, self.look, q) for q in known[:: max(1, len(known) // CHANGED)]]

    def error(self, read: tuple[Job, Sequence[Pose], float]) -> ReadAgain:
        """Of positions that were read, see `reading_error`."""
        job, poses, since = read
        with self._scene(job) as scene:
            return reading_error(scene, self.look, *job, poses, self.bank, since)

    def _scene(self, job: Job) -> Scene:
        height, width = job[2].shape[1:3]
        return Scene(self.model, self.camera, (height, width), self.quality, self.halved)


def _camera(recordings: Sequence[Recording], model: mujoco.MjModel, camera: str | None) -> str:
    """The name of the camera that looked.

    Raises:
        InputError: if it cannot be told.
    """
    named = {str(r.camera["name"]) for r in recordings if r.camera is not None and "name" in r.camera}
    if camera is None and len(named) > 1:
        raise InputError(f"The recordings name the cameras {sorted(named)} in meta.json; say which one, --camera NAME.")
    return the_camera(model, camera or (named.pop() if named else None))


def _positions(
    recordings: Sequence[Recording],
    model: mujoco.MjModel,
    films: Films,
    followed: Sequence[Sequence[Pose]],
    look: Look,
    parameters: tuple[LookParameter, ...],
    camera: str,
    again: Sequence[ReadAgain],
    by_look: LookErrors | None,
) -> Positions:
    """As recordings of joint positions."""
    explained = tuple(np.array([pose.explained for pose in poses]) for poses in followed)
    astray = read_astray(again)
    told = astray <= MOST_ASTRAY
    readable = tuple(np.array([told and pose.readable for pose in poses]) for poses in followed)
    read = [
        np.where(good[:, None], [pose.q for pose in poses], np.nan)
        for poses, good in zip(followed, readable, strict=True)
    ]
    found = ErrorModel.of(again)
    errors = tuple(found.deviation(unexplained_by(poses), fit_variance_of(poses)) for poses in followed)
    same_turns = on_common_turns(read, turning(model))
    out = []
    for recording, times, q, error in zip(recordings, films.times, same_turns, errors, strict=True):
        units = tuple("m" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "rad" for kind in model.jnt_type)
        own = {key: unit for key, unit in recording.units.items() if key != "qvel"}
        names = tuple(model.joint(j).name for j in range(model.njnt))
        changed = {"joint_names": names, "t_state": times, "qpos": q, "qvel": None, "units": {**own, "qpos": units}}
        out.append(replace(recording, **changed, qpos_std=np.where(np.isfinite(q), error, np.nan)))
    deviation = tuple(np.sqrt(fit_variance_of(poses)) for poses in followed)
    return Positions(
        tuple(out),
        deviation,
        explained,
        readable,
        parameters,
        look.values,
        look.deviation,
        camera,
        films.size,
        np.sqrt(found.usual),
        errors,
        frames_together([part.error / found.deviation(part.unexplained, part.fit_variance) for part in again]),
        astray,
        by_look,
        films.repeated,
        tuple(np.array([pose.out_of_view for pose in poses]) for poses in followed),
    )
