"""A mechanism as points and lines in a plane."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.rigid_body.links import rigid

Array = NDArray[np.float64]
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
NEAR = 0.02
"""Points closer than this share of the mechanism's size are one."""


@dataclass(frozen=True)
class Node:
    """A point fixed to a body.

    Attributes:
        body: id.
        local: `[3]` in the body's frame, m.
        joint: id of the joint that turns about it or slides with it, None for the end of a link.
    """

    body: int
    local: tuple[float, float, float]
    joint: int | None = None


@dataclass(frozen=True)
class Link:
    """A rigid bar between two nodes.

    Attributes:
        body: id.
        start: index of a node.
        end: index of a node.
    """

    body: int
    start: int
    end: int


@dataclass(frozen=True)
class Skeleton:
    """Nodes and links of a model, and the plane that shows them best.

    Attributes:
        model: of hinges and slides.
        nodes: the anchors of all joints in their order, then ends of links.
        links: between them.
        axes: `[2, 3]` world directions that point right and up.
    """

    model: mujoco.MjModel
    nodes: tuple[Node, ...]
    links: tuple[Link, ...]
    axes: Array

    @cached_property
    def _data(self) -> mujoco.MjData:
        return mujoco.MjData(self.model)

    def at(self, q: Array) -> Array:
        """Points `[..., nodes, 2]` of the plane at positions `[..., nq]`, m; NaN where a position is."""
        return self.in_space(q) @ self.axes.T

    def in_space(self, q: Array) -> Array:
        """Points `[..., nodes, 3]` of the world at positions `[..., nq]`, m; NaN where a position is."""
        flat = np.asarray(q, dtype=np.float64).reshape(-1, self.model.nq)
        out = np.full((len(flat), len(self.nodes), 3), np.nan)
        bodies, local = [n.body for n in self.nodes], np.array([n.local for n in self.nodes])
        for row, position in enumerate(flat):
            if np.isfinite(position).all():
                self._data.qpos[:] = position
                mujoco.mj_kinematics(self.model, self._data)
                turned = np.einsum("kij,kj->ki", self._data.xmat[bodies].reshape(-1, 3, 3), local)
                out[row] = self._data.xpos[bodies] + turned
        return out.reshape(*np.shape(q)[:-1], len(self.nodes), 3)

    def direction(self, joint: int, q: Array) -> Array:
        """`[2]` of a slide's axis at positions `[nq]`."""
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self._data)
        return self.axes @ self._data.xaxis[joint]


def skeleton(model: mujoco.MjModel) -> Skeleton:
    """The skeleton of a model of hinges and slides."""
    joints = [Node(int(model.jnt_bodyid[j]), _triple(model.jnt_pos[j]), j) for j in range(model.njnt)]
    nodes, links = list(joints), []
    for body in (b for b in range(1, model.nbody) if model.body_dofnum[b]):
        group = rigid(model, body)
        own = [j for j in range(model.njnt) if model.jnt_bodyid[j] == body]
        hub = own[-1]
        next_bodies = [b for b in range(1, model.nbody) if model.body_parentid[b] in group and model.body_dofnum[b]]
        ends = [int(model.body_jntadr[b]) for b in next_bodies if model.jnt_type[model.body_jntadr[b]] == HINGE]
        if not ends:
            nodes.append(Node(*_tip(model, group, body, np.asarray(joints[hub].local))))
            ends = [len(nodes) - 1]
        links += [Link(body, hub, end) for end in ends]
    return Skeleton(model, tuple(nodes), tuple(links), _axes(model))


def _tip(model: mujoco.MjModel, group: list[int], body: int, hub: Array) -> tuple[int, tuple[float, float, float]]:
    """The farthest point of a link's shape from its joint; its centre of mass if it has no shape."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    origin, turn = data.xpos[body], data.xmat[body].reshape(3, 3)
    points = [
        turn.T @ (p - origin) for g in range(model.ngeom) if model.geom_bodyid[g] in group for p in _ends(data, g)
    ]
    points += [turn.T @ (data.xipos[b] - origin) for b in group if model.body_mass[b] > 0]
    if not points:
        return body, _triple(hub)
    return body, _triple(max(points, key=lambda p: float(np.linalg.norm(p - hub))))


def _ends(data: mujoco.MjData, geom: int) -> Iterator[Array]:
    """World points that span a geom: its centre, and the ends of its longest axis."""
    model, centre, turn = data.model, data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    yield centre
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    types = mujoco.mjtGeom
    half = np.zeros(3)
    if kind in (int(types.mjGEOM_CAPSULE), int(types.mjGEOM_CYLINDER)):
        half[2] = size[1]
    elif kind in (int(types.mjGEOM_BOX), int(types.mjGEOM_ELLIPSOID)):
        half[int(size.argmax())] = size.max()
    elif kind == int(types.mjGEOM_MESH):
        box = model.geom_aabb[geom]
        centre, half[int(box[3:].argmax())] = centre + turn @ box[:3], box[3:].max()
    yield centre + turn @ half
    yield centre - turn @ half


def _axes(model: mujoco.MjModel) -> Array:
    """Right and up: of the plane at right angles to parallel hinges, else of the plane nearest to where bodies go."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hinges, slides = (data.xaxis[model.jnt_type == kind] for kind in (HINGE, SLIDE))
    first = hinges[0] if len(hinges) else None
    flat = first is not None and np.abs(slides @ first).max(initial=0.0) < 0.5
    if first is None or not flat or np.abs(hinges @ first).min() < 0.9:
        rng, points = np.random.default_rng(0), []
        for _ in range(20):
            data.qpos[:] = rng.uniform(-1, 1, model.nq)
            mujoco.mj_kinematics(model, data)
            points.append(np.concatenate([data.xanchor, data.xipos[1:]]))
        spread = np.concatenate(points)
        first = np.linalg.svd(spread - spread.mean(axis=0))[2][2]
    depth = first / np.linalg.norm(first)
    gravity = np.asarray(model.opt.gravity)
    guesses = [-gravity, np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])]
    flattened = [g - depth * (g @ depth) for g in guesses]
    up = next(g / np.linalg.norm(g) for g in flattened if np.linalg.norm(g) > 0.1)
    right = np.cross(depth, up)
    largest = int(np.abs(right).argmax())
    return np.stack([right * np.sign(right[largest]), up])


def _triple(point: Array) -> tuple[float, float, float]:
    return float(point[0]), float(point[1]), float(point[2])
