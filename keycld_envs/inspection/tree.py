"""Keypoints, rods and sliders for the bodies of an MJCF document, where they can say how its bodies move."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.inspection.poses import SIDE
from keycld_envs.mechanism import Rod, Slider
from keycld_envs.projection import world_to_image
from keycld_envs.systems import Landmark

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)
ROUND = SPHERE, int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
SAME = 1e-3
"""m; places closer than that, seen along the hinges, are one."""
FLAT = 0.1
"""Height of a triangle of three rods as a share of its longest side; a flatter one does not hold its shape."""
OTHERWISE = "a diagnosis needs no declaration, see `keycld diagnose --mjcf`"


@dataclass(frozen=True, eq=False)
class Place:
    """A point on a body that others are held by.

    Attributes:
        keypoint: index of the keypoint there; None is the pivot.
        at: [3] m, in the configuration that the document draws.
    """

    keypoint: int | None
    at: NDArray[np.float64]


@dataclass(eq=False)
class Tree:
    """What is declared, put together body by body.

    Attributes:
        model: the compiled document.
        data: its state in the configuration that the document draws.
        camera: that looks along the hinges.
        landmarks: one for each keypoint.
        rods: between them.
        sliders: rails through the pivot.
        places: of each body that moves, by its index; 0 is the ground.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    camera: str
    landmarks: list[Landmark] = field(default_factory=list)
    rods: list[Rod] = field(default_factory=list)
    sliders: list[Slider] = field(default_factory=list)
    places: dict[int, list[Place]] = field(default_factory=lambda: {0: []})

    @classmethod
    def of(cls, model: mujoco.MjModel, camera: str) -> "Tree":
        """Keypoints and constraints of all bodies that move.

        Args:
            model: the compiled document; its joints are hinges and slides.
            camera: name of the camera.

        Raises:
            InputError: if rods and sliders cannot say how a body moves.
        """
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        tree = cls(model, data, camera)
        for body in range(1, model.nbody):
            if model.body_jntnum[body]:
                tree._add(body)
        return tree

    @property
    def pivot(self) -> tuple[float, float]:
        """In image units."""
        if not self.places[0]:
            return (0.0, 0.0)
        x, y = self._in_image(self.places[0][0].at)
        return (float(x), float(y))

    def _add(self, body: int) -> None:
        joints = range(self.model.body_jntadr[body], self.model.body_jntadr[body] + self.model.body_jntnum[body])
        hinges = [j for j in joints if self.model.jnt_type[j] == HINGE]
        slides = [j for j in joints if self.model.jnt_type[j] == SLIDE]
        name, parent = self.model.body(body).name, self._moving_parent(body)
        if len(hinges) > 1:
            raise InputError(
                f"Body {name!r} has {len(hinges)} hinges, of which images in a plane show one; give each a body of its "
                f"own, or leave the others out ({OTHERWISE})."
            )
        if slides and parent:
            raise InputError(
                f"Body {name!r} slides on {self.model.body(parent).name!r}, which moves; rails are on the ground, so "
                f"it cannot be declared ({OTHERWISE})."
            )
        self.places[body] = []
        if slides:
            following = [*self._next_joints(body), self.data.xanchor[joints[-1]]]
            first = self.data.xanchor[hinges[0]] if hinges else following[0]
            self._on_rail(body, slides, first.copy())
        elif hinges:
            self.places[body].append(self._joint(body, parent, hinges[0]))
        if hinges:
            start = self.places[body][0]
            end = self._keypoint(body, self._far(body, start.at))
            self.rods.append(Rod(start.keypoint, end))

    def _on_rail(self, body: int, slides: list[int], at: NDArray[np.float64]) -> None:
        """A keypoint that moves along a rail, or, with two slides, anywhere."""
        k = self._keypoint(body, at)
        if len(slides) == 1:
            ground = self.places[0] or [Place(None, at)]
            axis = self.data.xaxis[slides[0]]
            if np.linalg.norm(np.cross(axis, at - ground[0].at)) > SAME:
                raise InputError(
                    f"Body {self.model.body(body).name!r} slides on a rail that does not lead through the pivot of the "
                    f"bodies before it; a mechanism has one pivot, so it cannot be declared ({OTHERWISE})."
                )
            self.places[0] = ground
            self.sliders.append(Slider(k, self._normal(at, axis)))

    def _joint(self, body: int, parent: int, hinge: int) -> Place:
        """Where a body is hinged to another one or the ground; a keypoint is put there if there is none."""
        at, axis = self.data.xanchor[hinge].copy(), self.data.xaxis[hinge]
        if not parent and not self.places[0]:
            self.places[0].append(Place(None, at))
        there = [p for p in self.places[parent] if np.linalg.norm(np.cross(axis, p.at - at)) <= SAME]
        if there:
            return Place(there[0].keypoint, at)
        name, other = self.model.body(body).name, self.model.body(parent).name
        if not parent:
            raise InputError(
                f"Body {name!r} is hinged to the ground at another place than the bodies before it; a mechanism has "
                f"one pivot, so it cannot be declared ({OTHERWISE})."
            )
        first, *more = self.places[parent]
        k, rails = self._keypoint(parent, at), [s for s in self.sliders if s.keypoint == first.keypoint]
        if rails:
            along = self.data.xaxis[self.model.body_jntadr[parent]]
            held = np.linalg.norm(np.cross(along, at - first.at)) <= SAME
            self.sliders.append(Slider(k, rails[0].normal))
            self.rods.append(Rod(first.keypoint, k))
        else:
            held = bool(more) and _height(axis, first.at, more[0].at, at) > FLAT
            self.rods += [Rod(p.keypoint, k) for p in (first, *more[:1])]
        if not held:
            raise InputError(
                f"Body {name!r} is hinged to {other!r} at a place that rods and rails do not hold, beside its rail or "
                f"in line with its other joints; it cannot be declared ({OTHERWISE})."
            )
        return self.places[parent][-1]

    def _keypoint(self, body: int, at: NDArray[np.float64]) -> int:
        """A new one at a place, which others can be held by; its index."""
        local = self.data.xmat[body].reshape(3, 3).T @ (at - self.data.xpos[body])
        x, y, z = (float(v) for v in local)
        self.landmarks.append(Landmark(self.model.body(body).name, (x, y, z)))
        self.places[body].append(Place(len(self.landmarks) - 1, at))
        return len(self.landmarks) - 1

    def _normal(self, at: NDArray[np.float64], axis: NDArray[np.float64]) -> tuple[float, float]:
        """Across a rail, in the image."""
        x, y = np.diff(self._in_image(np.array([at, at + 0.1 * axis])), axis=0)[0]
        return (float(-y / np.hypot(x, y)), float(x / np.hypot(x, y)))

    def _in_image(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        return world_to_image(self.model, self.data, at, self.camera, SIDE, SIDE)

    def _moving_parent(self, body: int) -> int:
        """The nearest body towards the ground that has a joint; 0 if there is none."""
        return int(self.model.body_weldid[self.model.body_parentid[body]])

    def _next_joints(self, body: int) -> Iterator[NDArray[np.float64]]:
        """Where other bodies are joined to a body, [3] each, m."""
        for child in range(1, self.model.nbody):
            if self.model.body_jntnum[child] and self._moving_parent(child) == body:
                yield self.data.xanchor[self.model.body_jntadr[child]].copy()

    def _far(self, body: int, start: NDArray[np.float64]) -> NDArray[np.float64]:
        """[3] where the next body is joined, or the end of the geometry that is farthest from the joint, m."""
        for joint in self._next_joints(body):
            if np.linalg.norm(joint - start) > SAME:
                return joint
        ends = [self.data.xipos[body].copy()]
        for geom in np.flatnonzero(self.model.body_weldid[self.model.geom_bodyid] == body):
            middle, half = self._lengthwise(int(geom))
            ends += [middle + half, middle - half]
        return max(ends, key=lambda end: float(np.linalg.norm(end - start)))

    def _lengthwise(self, geom: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """[3] middle of a geometry and [3] the way from there to the end of its longest side, m."""
        axes, middle = self.data.geom_xmat[geom].reshape(3, 3), self.data.geom_xpos[geom]
        kind, size = int(self.model.geom_type[geom]), self.model.geom_size[geom]
        if kind in ROUND:
            return middle, axes[:, 2] * size[1] * (kind != SPHERE)
        box = self.model.geom_aabb[geom]
        longest = int(box[3:].argmax())
        return middle + axes @ box[:3], axes[:, longest] * box[3 + longest]


def _height(axis: NDArray[np.float64], *corners: NDArray[np.float64]) -> float:
    """Height of a triangle, seen along an axis, as a share of its longest side."""
    a, b, c = (corner - axis * (corner @ axis) for corner in corners)
    sides = [float(np.linalg.norm(v)) for v in (b - a, c - b, a - c)]
    return float(np.linalg.norm(np.cross(b - a, c - a))) / max(sides) ** 2
