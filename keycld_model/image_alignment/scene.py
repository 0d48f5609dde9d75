"""A simulator's picture of itself, for any positions and any look."""

import copy
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from keycld_envs.projection import distance_of_links, focal_length, pose, world_to_image
from keycld_envs.rendering import Quality, Renderer
from keycld_model.image_alignment.chroma import HalvedChroma
from keycld_model.image_alignment.look import CAMERA, lengthen, look_parameters, pixels_of, view_of

Array = NDArray[np.float64]
Image = NDArray[np.float32]
LEAST_BLUR = 1e-3
"""A blur of fewer pixels is none."""
STEP = 0.7
"""How far finite differences move what is seen, pixels: less drowns in the steps of pixels, more is not linear."""
FLATTEST = 14.0
"""Focal length, in halves of an image, that no camera exceeds: beyond it, there is no perspective to be told."""
BLUR_STEP = 0.1
"""Step of the variance of a blur, square pixels."""


def softened(image: Image, blur: float) -> Image:
    """An image `[H, W, 3]` blurred by a Gaussian of so many pixels."""
    return np.asarray(gaussian_filter(image, (blur, blur, 0)), np.float32) if blur > LEAST_BLUR else image


class Slopes(NamedTuple):
    """How an image changes with some numbers, by central differences.

    Attributes:
        first: `[k, H, W, 3]` derivatives.
        bend: `[H, W, 3]` how far the image is from a straight line within these steps, grey levels: edges that pass
            over whole pixels, thin lines, and textures as fine as pixels. There, derivatives tell little.
    """

    first: Image
    bend: Image

    @classmethod
    def of(cls, there: Image, beside: list[tuple[Image, Image]], widths: list[float]) -> "Slopes":
        """From an image, pairs of images after and before it, and the widths of these steps."""
        first = [(after - before) / np.float32(width) for (after, before), width in zip(beside, widths, strict=True)]
        bend = sum(((after + before) / 2 - there) ** 2 for after, before in beside)
        return cls(np.stack(first), np.sqrt(bend))


class Scene:
    """Draws a model at joint positions.

    Attributes:
        model: as it is believed to be.
        size: of images, (H, W).
        parameters: of its look.
        nominal: `[p]` their values in the simulator.
        focal: length of the camera, pixels.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        camera: str,
        size: tuple[int, int],
        quality: Quality,
        halved: HalvedChroma | None = None,
    ) -> None:
        """With a camera of the model, and chroma as films have it; opens OpenGL.

        Raises:
            InputError: if no OpenGL context can be opened.
        """
        self.model, self.size, self._camera, self._halved = model, size, camera, halved
        self.parameters = look_parameters(model, size)
        self.nominal = np.zeros(len(self.parameters))
        self._drawn = copy.copy(model)
        self._data = mujoco.MjData(self._drawn)
        self._renderer = Renderer(self._drawn, size[1], size[0], quality)
        self._lengths = self.nominal
        self.focal = focal_length(model, camera, size[0])
        self._place(np.zeros(model.nq), self.nominal)
        self._distance = distance_of_links(self._drawn, self._data, camera)

    def __enter__(self) -> "Scene":
        return self

    def __exit__(self, *_: object) -> None:
        """Free OpenGL."""
        self._renderer.close()

    def render(self, q: Array, values: Array, soft: float = 0.0) -> Image:
        """The image `[H, W, 3]`, 0 to 255, at joint positions `[nq]` with a look `[p]`, softened by so many pixels."""
        self._place(q, values)
        view = view_of(values, self._distance)
        image = self._renderer.render(self._data, self._camera, view).astype(np.float32)
        blurred = softened(image, float(np.sqrt(values[-1] + soft**2)))
        return blurred if self._halved is None else self._halved.drawn(blurred)

    def jacobian(self, q: Array, values: Array, steps: Array, there: Image, soft: float = 0.0) -> Slopes:
        """How the image `there` changes with the joints, in central differences of these steps `[nq]`."""
        moves = [s * e for s, e in zip(steps, np.eye(len(q)), strict=True)]
        beside = [(self.render(q + m, values, soft), self.render(q - m, values, soft)) for m in moves]
        return Slopes.of(there, beside, [2 * float(s) for s in steps])

    def look_jacobian(self, q: Array, values: Array, there: Image, soft: float = 0.0) -> Slopes:
        """How the image `there` changes with the look, in central differences."""
        beside, widths = [], []
        for k, step in enumerate(self.look_steps()):
            after, before = values.copy(), values.copy()
            after[k] += step
            before[k] -= step if k < len(values) - 1 else min(step, values[-1])  # a variance is not negative
            beside.append((self.render(q, after, soft), self.render(q, before, soft)))
            widths.append(float(after[k] - before[k]))
        return Slopes.of(there, beside, widths)

    def joint_steps(self, q: Array, values: Array) -> Array:
        """Changes of each joint `[nq]`, rad or m, that move the outermost of what is seen by about `STEP` pixels."""
        small = 1e-3
        there = self._points(q, values)
        moved = [np.abs(self._points(q + small * e, values) - there).max() for e in np.eye(len(q))]
        return np.array([STEP * small / max(m, 0.05 * small) for m in moved])

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest joint positions `[nq]` to look at: limits, a turn, or what the camera sees of a slide."""
        low, high = np.empty((2, self.model.nq))
        for j in range(self.model.njnt):
            if self.model.jnt_limited[j]:
                low[j], high[j] = self.model.jnt_range[j]
            elif self.model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE:
                low[j], high[j] = -np.pi, np.pi
            else:
                low[j], high[j] = self._visible(j)
        return low, high

    def in_view(self, q: Array, values: Array) -> float:
        """Share of a link's length that is inside the image, of the link that is least so."""
        height, width = self.size
        ends = self._ends(q, values) * [2 / (width - 1), 2 / (height - 1)]
        along = np.linspace(0.0, 1.0, 21)[:, None, None]
        x, y = np.moveaxis(pixels_of(ends[0] + along * (ends[1] - ends[0]), values, self.size, self.focal), -1, 0)
        share = np.mean((x > -0.5) & (x < width - 0.5) & (y > -0.5) & (y < height - 0.5), axis=0)
        link = self.model.body_weldid[self.model.geom_bodyid[self._moving]]
        joints = self.model.body_weldid[self.model.jnt_bodyid]
        return min((float(share[link == j].max()) for j in joints if (link == j).any()), default=1.0)

    def _visible(self, joint: int) -> tuple[float, float]:
        """How far a slide moves until its body leaves the image, m, from its zero."""
        q, size = np.zeros(self.model.nq), max(self.size)
        there = self._points(q, self.nominal)
        q[joint] = 1e-2
        per_metre = float(np.abs(self._points(q, self.nominal) - there).max()) / 1e-2
        reach = size / 2 / max(per_metre, 1e-3)
        return -reach, reach

    def look_steps(self) -> Array:
        """Steps of finite differences: each moves what is seen by about `STEP` pixels."""
        half = max(self.size) / 2
        focal = min(self.focal, FLATTEST * half)
        keystone = half**2 / focal
        far = [focal / 2, focal / 2, half / 2]  # of what is as far behind the mechanism as the camera is before it
        lengths = [half / 2] * (len(self.parameters) - len(CAMERA) - 1)
        pixels = [1.0, 1.0, half, half, half, keystone, keystone, *far, *lengths]
        return np.array([STEP / p for p in pixels] + [BLUR_STEP])

    def _place(self, q: Array, values: Array) -> None:
        if not np.array_equal(self._lengths, values[len(CAMERA) : -1]):
            for name in ("body_pos", "geom_pos", "geom_size"):
                getattr(self._drawn, name)[:] = getattr(self.model, name)
            for parameter, value in zip(self.parameters, values, strict=True):
                if parameter.body is not None:
                    lengthen(self._drawn, parameter.body, float(np.exp(value)))
            self._lengths = np.array(values[len(CAMERA) : -1])
        pose(self._drawn, self._data, q)

    @property
    def compressed(self) -> bool:
        """Whether it is drawn as compressed films show it."""
        return self._halved is not None

    @property
    def _moving(self) -> NDArray[np.intp]:
        """Indices `[G]` of geoms that move."""
        return np.flatnonzero(self.model.body_weldid[self.model.geom_bodyid] > 0)

    def _points(self, q: Array, values: Array) -> Array:
        """Pixels `[2 G, 2]` from the centre, of the ends of all geoms that move, for a camera as the simulator's."""
        return self._ends(q, values).reshape(-1, 2)

    def _ends(self, q: Array, values: Array) -> Array:
        """The same as `[2, G, 2]`."""
        self._place(q, values)
        model, data, moving = self._drawn, self._data, self._moving
        axis = data.geom_xmat.reshape(-1, 3, 3)[moving, :, 2]
        reach = np.where(model.geom_type[moving] == mujoco.mjtGeom.mjGEOM_SPHERE, 0, model.geom_size[moving, 1])
        ends = np.stack([data.geom_xpos[moving] + sign * reach[:, None] * axis for sign in (-1, 1)])
        height, width = self.size
        seen = world_to_image(model, data, ends, self._camera, width, height)
        return seen * [(width - 1) / 2, (height - 1) / 2]
