"""What a camera that is not quite the simulator's shows of a sealed case."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.blind.parameter_errors import ParameterErrors
from keycld_envs.disturbance import Disturbance
from keycld_envs.rendering import Renderer, View
from keycld_envs.systems import get_system

Array = NDArray[np.float64]
SIZE = 64
"""Width and height of frames, pixels."""
RATE = 50.0
"""Frames per second."""
SHIFTED = 1 / 3
"""Share of the cases in which frames look otherwise, too: light, noise and compression."""
STEP = 0.01
"""Over which slopes of images are told, rad or m: a tenth of a pixel to a third of one."""
DRAWN = 0.03
"""Pixels by which single frames tell positions no better, whatever their noise: they are drawn with four samples to a
pixel, of a camera that is not quite known. What reading is asked to reach."""
UNSEEN = 10.0
"""How well positions are known without seeing them, rad or m."""
ROUNDED = 1 / 12
"""Variance of rounding to whole grey levels."""


@dataclass(frozen=True, kw_only=True)
class Film(Disturbance):
    """A camera and its light.

    Attributes:
        shifted: light, noise and compression are far from the simulator's.
        aside: the camera stands farther right by so much of the mechanism's distance.
        above: and upwards.
        nearer: and forwards.
    """

    shifted: bool
    aside: float = 0.0
    above: float = 0.0
    nearer: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Film":
        """Errors of a camera that was put up by hand."""
        shifted = bool(rng.random() < SHIFTED)
        light = float(np.exp(rng.uniform(-0.35, 0.26) if shifted else rng.normal(0, 0.05)))
        return cls(
            right=float(rng.normal(0, 1.5)),
            up=float(rng.normal(0, 1.5)),
            zoom=float(np.exp(rng.normal(0, 0.03))),
            aspect=float(np.exp(rng.normal(0, 0.015))),
            roll=float(rng.normal(0, 0.03)),
            blur=float(rng.uniform(0, 1.0 if shifted else 0.4)),
            gain=_gain(light, 0.08 if shifted else 0.02, rng),
            offset=float(rng.normal(0, 8 if shifted else 2)),
            noise=float(rng.uniform(2, 10) if shifted else rng.uniform(0, 3)),
            jpeg=int(rng.integers(75, 96)) if shifted and rng.random() < 0.5 else None,
            pitch=float(rng.normal(0, 0.02)),
            yaw=float(rng.normal(0, 0.02)),
            shifted=shifted,
            aside=float(rng.normal(0, 0.02)),
            above=float(rng.normal(0, 0.02)),
            nearer=float(rng.normal(0, 0.02)),
        )

    def seen_from(self, distance: float) -> View:
        """How a mechanism is seen at a distance from the simulator's camera, m."""
        return replace(self.view, aside=self.aside, above=self.above, nearer=self.nearer, distance=distance)

    def answer(self) -> dict[str, Any]:
        """All numbers."""
        return asdict(self)


def _gain(light: float, spread: float, rng: np.random.Generator) -> tuple[float, float, float]:
    """Of three colours, which differ from the light by a spread."""
    red, green, blue = (light * float(g) for g in np.exp(rng.normal(0, spread, 3)))
    return red, green, blue


class Stage:
    """One system as a camera has it before it, its links as long as they are."""

    def __init__(self, system: str, errors: ParameterErrors) -> None:
        """In its zero position."""
        declared = get_system(system)
        self._camera, self._model = declared.camera, declared.compile()
        lengthen(self._model, errors)
        self._data = mujoco.MjData(self._model)
        self._distance = self._depth()

    def in_image(self, positions: Array, film: Film) -> NDArray[np.bool_]:
        """Whether the middle of every part is inside the image, at positions `[T, nv]`: `[T]`."""
        camera, view, out = self._model.camera(self._camera).id, film.seen_from(self._distance), []
        for q in positions:
            self._place(q)
            away = self._data.geom_xpos[self._moving] - self._data.cam_xpos[camera]
            right, up, backward = (away @ self._data.cam_xmat[camera].reshape(3, 3)).T
            x, y = view.place(self._focal * right / -backward, self._focal * up / -backward, self._focal)
            out.append(bool((np.maximum(np.abs(x), np.abs(y)) < SIZE / 2).all()))
        return np.array(out)

    @property
    def _focal(self) -> float:
        """Of the camera, pixels."""
        return float(SIZE / 2 / np.tan(np.radians(self._model.camera(self._camera).fovy[0]) / 2))

    @property
    def _moving(self) -> NDArray[np.intp]:
        """Indices of the geoms that move."""
        return np.flatnonzero(self._model.body_weldid[self._model.geom_bodyid] > 0)

    def _pixels_per_unit(self, q: Array) -> Array:
        """By how many pixels each joint moves what it moves most, per rad or m `[nv]`."""
        camera, there = self._model.camera(self._camera), self._ends(q)
        depth = np.linalg.norm(self._data.cam_xpos[camera.id] - there, axis=-1)
        moved = [np.linalg.norm(self._ends(q + STEP * e) - there, axis=-1) for e in np.eye(len(q))]
        return np.array([self._focal * (m / depth).max() / STEP for m in moved])

    def _depth(self) -> float:
        """Of the links from the camera, on average and along its axis, m."""
        self._place(np.zeros(self._model.nq))
        camera = self._model.camera(self._camera).id
        backward = self._data.cam_xmat[camera].reshape(3, 3)[:, 2]
        links = self._data.geom_xpos[self._moving]
        return float(np.mean((self._data.cam_xpos[camera] - links) @ backward))

    def _ends(self, q: Array) -> Array:
        """Both ends `[2, G, 3]` of the axes of all geoms, m."""
        self._place(q)
        half = self._data.geom_xmat.reshape(-1, 3, 3)[:, :, 2] * self._model.geom_size[:, 1:2]
        return np.stack([self._data.geom_xpos - half, self._data.geom_xpos + half])

    def _place(self, q: Array) -> None:
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)


class Studio(Stage):
    """Films it."""

    def __init__(self, system: str, errors: ParameterErrors) -> None:
        """Opens OpenGL."""
        super().__init__(system, errors)
        self._renderer = Renderer(self._model, SIZE, SIZE, "fast")

    def __enter__(self) -> "Studio":
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def shoot(self, positions: Array, film: Film, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Frames `[T, H, W, 3]` of positions `[T, nv]`."""
        out, view = [], film.seen_from(self._distance)
        for q in positions:
            self._place(q)
            out.append(film.develop(self._renderer.render(self._data, self._camera, view), rng))
        return np.stack(out)

    def reading_deviation(self, positions: Array, film: Film, rng: np.random.Generator) -> Array:
        """Standard deviations `[nv]` of joint positions that are read off single frames as well as can be, rad or m.

        Two errors, which add as squares. What noise and compression do: the bound of Cramér and Rao for a camera that
        is known; J the slopes of an image without noise in the positions, s^2 the mean square, where J is, of what they
        do to the image, the covariance is s^2 inv(J'J). And what drawing with few samples to a pixel does: `DRAWN`
        pixels of the part of the mechanism that a joint moves most. The median over the frames.

        Args:
            positions: `[T, nv]` of the frames.
            film: the camera.
            rng: of the noise.
        """
        pure, nv = replace(film, noise=0.0, jpeg=None), positions.shape[1]
        bounds = []
        for q in positions:
            near = self.shoot(np.concatenate([q + STEP * np.eye(nv), q - STEP * np.eye(nv)]), pure, rng).astype(float)
            slopes = (near[:nv] - near[nv:]).reshape(nv, -1) / (2 * STEP)
            off = self.shoot(q[None], film, rng).astype(float) - self.shoot(q[None], pure, rng)
            weight = np.sum(slopes**2, axis=0)
            if not weight.any():  # nothing that moves is in the image
                bounds.append(np.full(nv, UNSEEN))
                continue
            variance = np.average(off.ravel() ** 2, weights=weight) + ROUNDED
            drawn = DRAWN / self._pixels_per_unit(q)
            bounds.append(np.sqrt(variance * np.diag(np.linalg.pinv(slopes @ slopes.T)) + drawn**2))
        return np.median(bounds, axis=0)


def lengthen(model: mujoco.MjModel, errors: ParameterErrors) -> None:
    """Let links look as long as they are: the plant's lengths, and what is drawn of them."""
    errors.apply(model)
    model.geom_sameframe[:] = 0  # geoms leave the centres of mass
    tubes = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
    for name, factor in errors.length.items():
        for geom in range(model.ngeom):
            if model.body_weldid[model.geom_bodyid[geom]] == model.body(name).id:
                model.geom_pos[geom] *= factor
                if model.geom_type[geom] in tubes:
                    model.geom_size[geom, 1] *= factor
