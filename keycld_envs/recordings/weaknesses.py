"""What is weak in recordings that a model shall learn from, said before hours are spent on them."""

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.mechanism import Mechanism, Rod
from keycld_envs.projection import pose
from keycld_envs.recordings.crop import LEVELS, moving_box, square
from keycld_envs.recordings.dataset import Dataset, Sequences
from keycld_envs.systems import System

FEWEST = 5000
"""Frames in all: with 100 recordings of 50 frames the acrobot is predicted for .996 of the time, with 50 for .88."""
FASTEST = 0.7
"""Radians that a link may turn from one frame to the next. The pendulum turns up to 0.52 and is learned; at a quarter
turn, neighbouring frames no longer tell which way."""
OFTEN = 0.02
"""Fraction of frames in which something may be too fast."""
STILL = 1.0
"""Pixels; what varies less over all recordings stays where it is."""
STOPPED = 0.01
"""Fraction of frames at the end of a joint's range; each changes all motion that follows."""
SMALLEST_JOINT = 0.05
"""rad or m; a joint that varies less over all recordings hardly moves."""
SLOW = 128 * 128
"""Pixels of a frame, beyond which training takes more than four times as long as with 64 x 64."""
ASIDE = 0.35
"""Standard deviation of the distance from the pivot of what moves, of its place's. A rod that turns about the pivot
has .02 to .15, since it has a shadow and an end; pivots that are .2 image units off have .2 to .5, distant ones .6 to
.8."""


def weaknesses(dataset: Dataset, system: System | None = None, mechanism: Mechanism | None = None) -> Iterator[str]:
    """What is weak, a sentence each with what to record instead; what costs memory comes before it is spent.

    Args:
        dataset: the recordings.
        system: the simulation that they are of, if there is one; where keypoints are is then known.
        mechanism: what is declared of recordings without a simulation.

    Raises:
        InputError: if the recordings cannot be stacked.
    """
    yield from _size(dataset)
    data = dataset.sequences()
    yield from (*_amount(data), *_speed(dataset, data), *_actions(dataset, data))
    if system is not None and data.qpos is not None and data.qpos.shape[2] == len(system.joints):
        yield from (*_still_keypoints(system, data.qpos), *_stops(system, data.qpos))
    else:
        yield from _still_joints(dataset, data)
    if mechanism is not None and data.qpos is None:
        yield from _one_rod(mechanism, data)


def _amount(data: Sequences) -> list[str]:
    number, length = data.frames.shape[:2]
    if number * length >= FEWEST:
        return []
    more = -(-FEWEST // length)
    return [f"{number} recordings of {length} frames are few to learn from; record at least {more} of them."]


def _size(dataset: Dataset) -> list[str]:
    first = next(iter(dataset.recordings[0].iter_frames()), None)
    if first is None:
        return []
    height, width = first.shape[:2]
    large, oblong = height * width > SLOW, height != width
    if not large and not oblong:
        return []
    sample = dataset.recordings[:: max(1, len(dataset) // 10)]
    box = moving_box(frame for recording in sample for frame in recording.iter_frames())
    cut = () if box is None else square(box, width, height)
    keep = f" --box {' '.join(map(str, cut))}" if cut else ""
    why = f"take {height * width / 64**2:.0f} times the time and memory of 64x64" if large else ""
    why += " and " * (large and oblong) + "are not square, so that rods seem to change their lengths" * oblong
    return [
        f"Frames of {width}x{height} pixels {why}; cut them: keycld crop {dataset.folder} --out "
        f"{dataset.folder}-small{keep}."
    ]


def _speed(dataset: Dataset, data: Sequences) -> list[str]:
    if data.qpos is None:
        return []
    units = dataset.recordings[0].units.get("qpos", ())
    hinges = [i for i in range(data.qpos.shape[2]) if i >= len(units) or units[i] == "rad"]
    turned = np.abs(np.diff(data.qpos[..., hinges], axis=1))
    fast = turned > FASTEST
    if not turned.size or not fast.any(axis=-1).mean() > OFTEN:
        return []
    name = dataset.recordings[0].joint_names[hinges[int(fast.mean(axis=(0, 1)).argmax())]]
    strongest = np.abs(data.actions).max(initial=0.0)
    pushed = np.abs(data.actions[fast.any(axis=(1, 2))]).mean() if data.actions.size else 0.0
    weaker = pushed > 1.2 * np.abs(data.actions).mean() if data.actions.size else False
    remedy = f"--action-range {strongest / 2:.2g}" if weaker else f"a frame every {data.timestep / 2:.2g} s"
    why = "actions are too strong" if weaker else "motion is too fast for the frame rate"
    return [
        f"Joint {name!r} turns by up to {turned.max():.2g} rad from one frame to the next, by more than {FASTEST:g} in "
        f"{100 * fast.any(axis=-1).mean():.0f} % of them: {why}; record with {remedy}."
    ]


def _actions(dataset: Dataset, data: Sequences) -> list[str]:
    names, found = dataset.recordings[0].actuator_names, []
    for i in range(data.actions.shape[2]):
        if np.ptp(data.actions[..., i]) < 1e-9:
            found.append(
                f"Actuator {names[i]!r} has the action {data.actions.flat[i]:g} in all recordings, which does not tell "
                "its effect; record with other actions, too."
            )
    return found


def _still_keypoints(system: System, qpos: NDArray[np.float64]) -> list[str]:
    """Of a simulation, whose keypoints are known."""
    model = system.compile()
    data, points = mujoco.MjData(model), []
    flat = qpos.reshape(-1, qpos.shape[2])
    for each in flat[:: max(1, len(flat) // 500)]:
        pose(model, data, each)
        points.append(system.keypoints(model, data))
    pixels = np.ptp(np.array(points), axis=0).max(axis=-1) * 63 / 2
    return [
        f"Keypoint {k} moves by {pixels[k]:.1f} pixels over all recordings and cannot be found; record motions of it, "
        "or leave it out of the mechanism."
        for k in np.flatnonzero(pixels < STILL)
    ]


def _stops(system: System, qpos: NDArray[np.float64]) -> list[str]:
    """Joints that run into the end of their range, of which a world model knows nothing."""
    model, found = system.compile(), []
    for j in np.flatnonzero(model.jnt_limited):
        low, high = model.jnt_range[j]
        at_end = (qpos[..., j] <= low) | (qpos[..., j] >= high)
        if at_end.mean() > STOPPED:
            found.append(
                f"Joint {system.joints[j].name!r} runs into the end of its range, {low:g} to {high:g}, in "
                f"{100 * at_end.any(axis=1).mean():.0f} % of the recordings, and a world model has no end stops; widen "
                "the range, start farther inside, or record with weaker actions."
            )
    return found


def _still_joints(dataset: Dataset, data: Sequences) -> list[str]:
    """Of a real mechanism."""
    if moving_box(data.frames[:, ::5].reshape(-1, *data.frames.shape[2:])) is None:
        return ["Nothing moves in the frames; record the mechanism in motion, in light that shows it."]
    if data.qpos is None:
        return []
    spread = np.ptp(data.qpos.reshape(-1, data.qpos.shape[2]), axis=0)
    return [
        f"Joint {dataset.recordings[0].joint_names[i]!r} moves by {spread[i]:.2g} over all recordings, so that what "
        "hangs on it cannot be told apart; record motions of it."
        for i in np.flatnonzero(spread < SMALLEST_JOINT)
    ]


def _one_rod(mechanism: Mechanism, data: Sequences) -> list[str]:
    """Of a single rod that turns about a fixed pivot, whether what moves does so, and slowly enough."""
    if mechanism.rods != (Rod(None, 0),) or mechanism.num_keypoints > 1 or mechanism.sliders:
        return []
    middle = _middle_of_motion(data.frames)
    if np.isnan(middle).all():
        return []
    arm = middle - np.array(mechanism.pivot)
    if np.nanvar(np.linalg.norm(arm, axis=-1)) > ASIDE**2 * np.nanvar(middle, axis=(0, 1)).sum():
        x, y = mechanism.pivot
        return [
            f"What moves does not turn about the pivot that is declared, ({x:g}, {y:g}) in image units: correct it, or "
            "let it be found, keycld discover."
        ]
    angle = np.arctan2(arm[..., 1], arm[..., 0])
    turned = np.abs((np.diff(angle, axis=1) + np.pi) % (2 * np.pi) - np.pi)
    fast = turned > FASTEST
    if fast.mean() <= OFTEN:
        return []
    return [
        f"The rod turns by up to {np.nanmax(turned):.2g} rad from one frame to the next, by more than {FASTEST:g} in "
        f"{100 * fast.mean():.0f} % of them: motion is too fast for the frame rate; record with a frame every "
        f"{data.timestep / 2:.2g} s."
    ]


def _middle_of_motion(frames: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Where frames [N, T, H, W, 3] differ from the scene at rest, image units [N, T, 2]; NaN where they do not."""
    number, length, height, width = frames.shape[:4]
    flat = frames.reshape(-1, height, width, 3)
    still = np.median(flat[:: max(1, len(flat) // 300)], axis=0)
    x, y = np.linspace(-1, 1, width), np.linspace(1, -1, height)
    out = np.full((len(flat), 2), np.nan)
    for i, frame in enumerate(flat):
        differs = np.square(frame - still).max(axis=-1)
        differs = np.maximum(differs - max(LEVELS**2, 9 * float(np.median(differs))), 0)  # the median is the noise's
        if total := differs.sum():
            out[i] = differs.sum(axis=0) @ x / total, differs.sum(axis=1) @ y / total
    return out.reshape(number, length, 2)
