"""Whether actuators move the mechanism, at a speed that frames can follow, and whether its target can be held."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.collect import PAPER_ACTION_RANGE
from keycld_envs.effects.edited import moments
from keycld_envs.inspection.poses import PIXEL, SIDE, Poses
from keycld_envs.recordings.weaknesses import FASTEST
from keycld_envs.simulation import Simulation
from keycld_envs.systems import System

FRAMES = 50
"""Of an episode, as `keycld collect` records them by default."""
EPISODES = 20
WEAKEST = 1.0
"""Pixels by which an actuator has to move some keypoint within an episode."""
FARTHEST = 10.0
"""Pixels that a keypoint may move from one frame to the next."""
SLOWEST = 3.0
"""Pixels that some keypoint should move within an episode."""
DRIFT = 0.2
"""rad or m within a second, from a hundredth beside `hanging_qpos`; beyond, it is no stable equilibrium."""
ACCELERATION = 0.05
"""rad/s² or m/s² at `hanging_qpos`; beyond, it is no equilibrium."""
SAME_POSE = 0.01
"""rad or m; a target that is less away from rest is no task."""
SPARE = 0.1
"""Share of half a motor's range that should be left when it holds the target."""
HALVINGS = 8


@dataclass(frozen=True)
class Actuator:
    """What an actuator does.

    Attributes:
        name: in the MJCF.
        low: least action that is tried.
        high: greatest.
        pixels: greatest difference that the greater of both makes to a keypoint within an episode.
    """

    name: str
    low: float
    high: float
    pixels: float


@dataclass(frozen=True)
class Speed:
    """How fast a mechanism moves under constant random actions.

    Attributes:
        action_range: bound of the actions; None for the system's own limits.
        radians: that the fastest link turns from one frame to the next.
        pixels: that the fastest keypoint moves from one frame to the next.
        travel: pixels that keypoints move within an episode, the median of episodes.
    """

    action_range: float | None
    radians: float
    pixels: float
    travel: float

    @property
    def too_fast(self) -> bool:
        """Whether neighbouring frames are too different to follow the motion."""
        return self.radians > FASTEST or self.pixels > FARTHEST


def action_range(system: System, limit: float | None = None) -> NDArray[np.float64]:
    """[m, 2] the actions that `keycld collect` draws from, with or without its `--action-range`."""
    simulation = Simulation(system, limit, ())
    limited = simulation.model.actuator_ctrllimited[:, None].astype(bool)
    bounds = np.where(limited, simulation.model.actuator_ctrlrange, [-np.inf, np.inf])
    return bounds if limit is not None else np.clip(bounds, -PAPER_ACTION_RANGE, PAPER_ACTION_RANGE)


def actuators(system: System, poses: Poses) -> tuple[Actuator, ...]:
    """What each does from hanging and from random poses, against no action."""
    simulation, bounds = Simulation(system, None, ()), action_range(system)
    starts = [poses.qpos[-1], *poses.qpos[:3]]
    idle = [_run(simulation, system, start, np.zeros(len(bounds)))[0] for start in starts]
    found = []
    for i, (low, high) in enumerate(bounds):
        action = np.zeros(len(bounds))
        action[i] = high if abs(high) >= abs(low) else low
        runs = [_run(simulation, system, start, action)[0] for start in starts]
        moved = max(float(np.abs(a - b).max()) for a, b in zip(runs, idle, strict=True)) / PIXEL
        found.append(Actuator(system.actuators[i], float(low), float(high), moved))
    return tuple(found)


def speed(system: System, seed: int, limit: float | None = None) -> Speed:
    """Of episodes as `keycld collect` records them."""
    simulation, bounds = Simulation(system, limit, ()), action_range(system, limit)
    radians, pixels, travel = [], [], []
    for index in range(EPISODES):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        start = system.sample_start("random", rng)[0]
        keypoints, angles = _run(simulation, system, start, rng.uniform(*bounds.T))
        steps = np.linalg.norm(np.diff(keypoints, axis=0), axis=-1) / PIXEL
        pixels.append(steps.max(initial=0.0))
        radians.append(np.abs(np.diff(angles, axis=0)).max(initial=0.0))
        travel.append(np.linalg.norm(np.ptp(keypoints, axis=0), axis=-1).max(initial=0.0) / PIXEL)
    return Speed(limit, float(max(radians)), float(max(pixels)), float(np.median(travel)))


def problems(system: System, poses: Poses, found: tuple[Actuator, ...]) -> Iterator[str]:
    """What is wrong with actuators, rest and target, a sentence each."""
    for actuator in found:
        if actuator.low == actuator.high:
            bounds = f"{actuator.low:g} to {actuator.high:g}"
            yield f"Actuator {actuator.name!r} has the range {bounds}; widen its ctrlrange."
        elif actuator.pixels < WEAKEST:
            yield (
                f"Actuator {actuator.name!r} has no effect: its greatest action moves no keypoint by more than "
                f"{actuator.pixels:.2f} pixels in {FRAMES} frames; raise its gear or ctrlrange, or remove it."
            )
    yield from _at_rest(poses)
    yield from _at_target(poses)


def advice(system: System, seed: int, poses: Poses, usual: Speed) -> Iterator[str]:
    """What makes the target hard to hold, and how to record what is too fast or slow by default, a sentence each."""
    yield from _hard_to_hold(poses)
    if usual.travel < SLOWEST:
        yield (
            f"Keypoints move {usual.travel:.1f} pixels within {FRAMES} frames, which is little to learn from; record "
            f"longer, --steps {10 * FRAMES}, or raise timestep."
        )
    if not usual.too_fast:
        return
    fast = (
        f"Keypoints move up to {usual.pixels:.0f} pixels and links turn up to {usual.radians:.1f} rad from one frame "
    )
    limit = float(np.abs(action_range(system)).max())
    for _ in range(HALVINGS):
        limit /= 2
        if not speed(system, seed, limit).too_fast:
            yield f"{fast}to the next, too fast to follow; record with --action-range {limit:.2g}, or lower timestep."
            return
    yield f"{fast}to the next, whatever the actions, too fast to follow; lower timestep, or narrow start_range."


def without_task(system: System) -> Iterator[str]:
    """Whether there is anything to do at all."""
    if system.actuators and np.abs(np.subtract(system.target_qpos, system.hanging_qpos)).max() < SAME_POSE:
        yield "target_qpos is hanging_qpos, where the mechanism is without any action; name where it should swing to."


def _run(
    simulation: Simulation, system: System, start: NDArray[np.float64], action: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Keypoints [T, K, 2], image units, and absolute angles [T, nhinges] of a run at a constant action."""
    model, data = simulation.model, simulation.data
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    simulation.reset(start, np.zeros(model.nv))
    keypoints, angles = [], []
    for _ in range(FRAMES):
        keypoints.append(system.keypoints(model, data, SIDE, SIDE))
        angles.append(data.qpos[hinges].copy())
        simulation.step(action)
    return np.array(keypoints), np.array(angles)


def _at_rest(poses: Poses) -> Iterator[str]:
    """Whether the mechanism stays at `hanging_qpos`."""
    system, simulation = poses.system, Simulation(poses.system, None, ())
    model, data, rest = simulation.model, simulation.data, poses.qpos[-1]
    simulation.reset(rest, np.zeros(model.nv))
    worst = int(np.abs(data.qacc).argmax())
    if abs(data.qacc[worst]) > ACCELERATION:
        yield (
            f"hanging_qpos is no equilibrium: joint {system.joints[worst].name!r} accelerates by "
            f"{data.qacc[worst]:.2g} {'rad' if system.joints[worst].kind == 'hinge' else 'm'}/s² there; name the "
            "configuration in which it hangs still."
        )
        return
    simulation.reset(rest + 0.01, np.zeros(model.nv))
    for _ in range(round(1 / system.timestep)):
        simulation.step(np.zeros(model.nu))
    if np.abs(data.qpos - rest).max() > DRIFT:
        yield "hanging_qpos is no stable equilibrium: from a hundredth beside it, the mechanism falls away; name one."


def _at_target(poses: Poses) -> Iterator[str]:
    """Whether motors can hold the target against gravity and springs."""
    system = poses.system
    if (holding := _holding(poses)) is None:
        return
    action, left, needed = holding
    if left.max() > 1e-3 * max(1.0, np.abs(needed).max()):
        yield (
            f"The target cannot be held: no action balances joint {system.joints[int(left.argmax())].name!r} at "
            "target_qpos; choose an equilibrium, or add an actuator."
        )
        return
    for i, low, high in _limits(system):
        if not low <= action[i] <= high:
            yield (
                f"The target cannot be held: actuator {system.actuators[i]!r} would need {action[i]:.3g} at "
                f"target_qpos, its range is {low:g} to {high:g}; widen its range, or choose another target."
            )


def _hard_to_hold(poses: Poses) -> Iterator[str]:
    """Whether holding the target leaves motors something to steer with."""
    if (holding := _holding(poses)) is None:
        return
    action, *_ = holding
    for i, low, high in _limits(poses.system):
        spare = min(action[i] - low, high - action[i]) / ((high - low) / 2)
        if 0 <= spare < SPARE:
            yield (
                f"Holding the target takes {action[i]:.3g} of actuator {poses.system.actuators[i]!r}, whose range is "
                f"{low:g} to {high:g}, which leaves little to steer with; widen its range, or choose another target."
            )


def _limits(system: System) -> list[tuple[int, float, float]]:
    """Index, least and greatest action of every limited actuator."""
    model = Simulation(system, None, ()).model
    limited = np.flatnonzero(model.actuator_ctrllimited)
    return [
        (int(i), float(low), float(high))
        for i, (low, high) in zip(limited, model.actuator_ctrlrange[limited], strict=True)
    ]


def _holding(
    poses: Poses,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Action [m] that balances the target best, what it leaves and what is needed [nv], N m or N; None if unknown."""
    system, model, data = poses.system, poses.model, mujoco.MjData(poses.model)
    plain = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE) & (
        model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
    )
    if not plain.all() or not model.nu:
        return None
    data.qpos[:] = system.target_qpos
    mujoco.mj_forward(model, data)
    needed = data.qfrc_bias - data.qfrc_passive
    gains = moments(model, system.target_qpos).T * model.actuator_gainprm[:, 0]
    action, *_ = np.linalg.lstsq(gains, needed, rcond=None)
    return action, np.abs(gains @ action - needed), needed
