"""Whether what is declared rigid is rigid, and whether keypoints and joints have as many ways to move."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.inspection.poses import PIXEL, Poses
from keycld_envs.inspection.tree import HINGE, SLIDE
from keycld_envs.mechanism import Mechanism, Rod, Slider

RIGID = 0.5 * PIXEL
"""Image units by which a constraint may vary, half a pixel: more than perspective and less than any motion."""
SHORTEST = 2 * PIXEL
"""Image units; the direction of a shorter rod is lost in pixels."""
RANK = 1e-6
"""Of the greatest singular value, below which one counts as zero."""


@dataclass(frozen=True)
class Value:
    """A constraint over all poses.

    Attributes:
        name: "rod 0-1", "rod pivot-0" or "slider 0".
        least: smallest length or offset from the rail, image units.
        most: greatest.
    """

    name: str
    least: float
    most: float

    @property
    def constant(self) -> bool:
        """Whether it varies by less than half a pixel."""
        return self.most - self.least <= RIGID


def rod_name(rod: Rod) -> str:
    """What to call a rod."""
    return f"rod {'pivot' if rod.start is None else rod.start}-{rod.end}"


def values(mechanism: Mechanism, keypoints: NDArray[np.float64]) -> tuple[Value, ...]:
    """Every rod's length and every slider's offset, in the order of the declaration.

    Args:
        mechanism: the declaration.
        keypoints: [P, K, 2] image units.
    """
    found = []
    for rod in mechanism.rods:
        start = np.array(mechanism.pivot) if rod.start is None else keypoints[:, rod.start]
        length = np.linalg.norm(keypoints[:, rod.end] - start, axis=1)
        found.append(Value(rod_name(rod), float(length.min()), float(length.max())))
    for slider in mechanism.sliders:
        normal = np.array(slider.normal) / np.linalg.norm(slider.normal)
        offset = (keypoints[:, slider.keypoint] - mechanism.pivot) @ normal
        found.append(Value(f"slider {slider.keypoint}", float(offset.min()), float(offset.max())))
    return tuple(found)


def problems(poses: Poses) -> Iterator[str]:
    """What is wrong with rods, sliders, pivot and degrees of freedom, a sentence each."""
    mechanism, wrong = poses.system.mechanism, False
    found = values(mechanism, poses.keypoints)
    for rod, value in zip(mechanism.rods, found, strict=False):
        if not value.constant:
            wrong = True
            yield _changing_rod(poses, rod, value)
        elif value.most < SHORTEST and not wrong:
            wrong = True
            pixels = value.most / PIXEL
            yield f"{value.name} is {pixels:.1f} pixels long; move its keypoints apart, or the camera nearer."
    for slider, value in zip(mechanism.sliders, found[len(mechanism.rods) :], strict=True):
        if not value.constant:
            wrong = True
            yield _leaving_rail(poses, slider.keypoint, value)
        elif max(-value.least, value.most) > RIGID:
            wrong = True
            yield _beside_pivot(poses, slider, value)
    if not wrong:
        yield from _freedom(poses)


def _changing_rod(poses: Poses, rod: Rod, value: Value) -> str:
    """What to say of a rod whose length is not constant."""
    says = (
        f"{value.name} is not rigid: it is {value.least:.2f} to {value.most:.2f} image units long over random poses; "
    )
    if rod.start is None and (centre := _centre(poses.keypoints[:, rod.end])) is not None:
        about = f"keypoint {rod.end} turns about pivot=({centre[0]:.3f}, {centre[1]:.3f})"
        if held := [other for other in poses.system.mechanism.rods if other != rod and _about_pivot(poses, other)]:
            return (
                f"{says}{about}, but keypoint {held[0].end} about the one that is declared; a mechanism has one pivot, "
                "so both cannot be declared together."
            )
        return f"{says}{about}."
    if (joint := _hinge(poses, rod)) is not None:
        return f"{says}keypoint {rod.end} turns about {joint}; put a keypoint there, and let the rod begin at it."
    return f"{says}connect keypoints whose distance does not change, or leave it out."


def _about_pivot(poses: Poses, rod: Rod) -> bool:
    """Whether a rod leads from the pivot to a keypoint that turns about it."""
    if rod.start is not None:
        return False
    return bool(np.ptp(np.linalg.norm(poses.keypoints[:, rod.end] - poses.system.mechanism.pivot, axis=1)) <= RIGID)


def _hinge(poses: Poses, rod: Rod) -> str | None:
    """The joint that the end of a rod turns about, if it is on the body of the rod's start, and where it is there."""
    if rod.start is None:
        return None
    model, data = poses.model, mujoco.MjData(poses.model)
    start, end = (model.body(poses.system.landmarks[k].body) for k in (rod.start, rod.end))
    if int(end.parentid[0]) != start.id or int(end.jntnum[0]) != 1 or model.jnt_type[end.jntadr[0]] != HINGE:
        return None
    mujoco.mj_forward(model, data)
    x, y, z = data.xmat[start.id].reshape(3, 3).T @ (data.xanchor[end.jntadr[0]] - data.xpos[start.id])
    return (
        f"joint {model.joint(end.jntadr[0]).name!r}, which is at Landmark({start.name!r}, ({x:.4g}, {y:.4g}, {z:.4g}))"
    )


def _beside_pivot(poses: Poses, slider: Slider, value: Value) -> str:
    """What to say of a slider whose rail does not lead through the pivot."""
    offset, pivot = (value.least + value.most) / 2, np.array(poses.system.mechanism.pivot)
    x, y = pivot + offset * np.array(slider.normal) / np.linalg.norm(slider.normal)
    others = [f"keypoint {s.keypoint}" for s in poses.system.mechanism.sliders if s != slider]
    others += [f"keypoint {r.end}" for r in poses.system.mechanism.rods if r.start is None]
    says = f"The rail of keypoint {slider.keypoint} lies {abs(offset):.2f} image units beside the pivot"
    if others:
        return f"{says}, which {others[0]} needs where it is; rails lead through the one pivot of a mechanism."
    return f"{says}; with pivot=({x:.3f}, {y:.3f}) it leads through it."


def _centre(points: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """[2] the centre of the circle that points [P, 2] lie on, if they lie on one."""
    columns = np.column_stack([2 * points, np.ones(len(points))])
    solution, _, rank, _ = np.linalg.lstsq(columns, (points**2).sum(axis=1), rcond=None)
    radius = np.linalg.norm(points - solution[:2], axis=1)
    return solution[:2] if rank == 3 and np.ptp(radius) < RIGID and radius.mean() < 10 else None


def _leaving_rail(poses: Poses, k: int, value: Value) -> str:
    """What to say of a slider whose keypoint leaves the rail."""
    points = poses.keypoints[:, k] - poses.keypoints[:, k].mean(axis=0)
    normal = np.linalg.svd(points, full_matrices=False)[2][1]
    says = (
        f"{value.name} leaves its rail: it is {value.least:.2f} to {value.most:.2f} image units beside it over random "
        "poses; "
    )
    if np.ptp(points @ normal) < RIGID:
        normal = normal * (1 if normal[np.abs(normal).argmax()] > 0 else -1)
        return f"{says}its keypoint moves along a line with normal=({normal[0]:.3f}, {normal[1]:.3f})."
    return f"{says}its keypoint does not move along a line, so declare a rod instead, or leave it out."


def _freedom(poses: Poses) -> Iterator[str]:
    """Compare the ways in which joints move keypoints with those that constraints leave."""
    mechanism, joints = poses.system.mechanism, poses.system.joints
    moved = np.abs(poses.jacobians).max(axis=(0, 1))
    if idle := [joint.name for joint, size in zip(joints, moved, strict=True) if size < RANK]:
        yield f"Joint {idle[0]!r} moves no keypoint; put a landmark on its body, or remove the joint."
        return
    ranks = [np.linalg.matrix_rank(j, RANK * np.linalg.norm(j)) for j in poses.jacobians[:-2]]
    if (rank := int(np.max(ranks))) < len(joints):
        yield (
            f"The keypoints show {rank} of the {len(joints)} degrees of freedom of the joints "
            f"({', '.join(j.name for j in joints)}); add a keypoint on the body that the others do not tell."
        )
    elif (declared := mechanism.degrees_of_freedom) > rank and (riding := _riding(poses.model)) is not None:
        yield (
            f"Joint {riding!r} slides on a body that moves, which rods and sliders cannot say: the mechanism has "
            f"{declared} degrees of freedom, its joints have {rank}; no world model can be declared for it."
        )
    elif declared > rank:
        yield (
            f"The mechanism has {declared} degrees of freedom, its {len(joints)} joints have {rank}; declare "
            f"{declared - rank} more of rods and sliders, or one keypoint less."
        )
    elif declared < rank:
        yield (
            f"The mechanism has {declared} degrees of freedom, its joints have {rank}; leave out {rank - declared} of "
            "its rods and sliders, which hold what others hold already."
        )


def _riding(model: mujoco.MjModel) -> str | None:
    """A slide joint on a body that other joints move, by name."""
    for joint in np.flatnonzero(model.jnt_type == SLIDE):
        if model.body_weldid[model.body_parentid[model.jnt_bodyid[joint]]]:
            return str(model.joint(int(joint)).name)
    return None
