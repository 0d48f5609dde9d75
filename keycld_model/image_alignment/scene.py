"""A simulator's picture of itself, for any positions and any look."""

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from keycld_envs.projection import pose, world_to_image
from keycld_envs.rendering import Quality, Renderer
from keycld_model.image_alignment.look import CAMERA, lengthen, look_parameters, view_of

Array = NDArray[np.float64]
Image = NDArray[np.float32]
LEAST_BLUR = 1e-3
"""A blur of fewer pixels is none."""
STEP = 0.7
"""How far finite differences move what is seen, pixels: less drowns in the steps of pixels, more is not linear."""
BLUR_STEP = 0.1
"""Step of the variance of a blur, square pixels."""


def softened(image: Image, blur: float) -> Image:
    """An image `[H, W, 3]` blurred by a Gaussian of so many pixels."""
    return np.asarray(gaussian_filter(image, (blur, blur, 0)), np.float32) if blur > LEAST_BLUR else image


class Scene:
    """Draws a model at joint positions.

    Attributes:
        model: as it is believed to be.
        size: of images, (H, W).
        parameters: of its look.
        nominal: `[p]` their values in the simulator.
    """

    def __init__(self, model: mujoco.MjModel, camera: str, size: tuple[int, int], quality: Quality) -> None:
        """With a camera of the model; opens OpenGL.

        Raises:
            InputError: if no OpenGL context can be opened.
        """
        self.model, self.size, self._camera = model, size, camera
        self.parameters = look_parameters(model, size)
        self.nominal = np.zeros(len(self.parameters))
        self._drawn = copy.copy(model)
        self._data = mujoco.MjData(self._drawn)
        self._renderer = Renderer(self._drawn, size[1], size[0], quality)
        self._lengths = self.nominal

    def __enter__(self) -> "Scene":
        return self

    def __exit__(self, *_: object) -> None:
        """Free OpenGL."""
        self._renderer.close()

    def render(self, q: Array, values: Array, soft: float = 0.0) -> Image:
        """The image `[H, W, 3]`, 0 to 255, at joint positions `[nq]` with a look `[p]`, softened by so many pixels."""
        self._place(q, values)
        image = self._renderer.render(self._data, self._camera, view_of(values)).astype(np.float32)
        return softened(image, float(np.sqrt(values[-1] + soft**2)))

    def jacobian(self, q: Array, values: Array, steps: Array, soft: float = 0.0) -> Image:
        """Derivative of the image to the joints, `[nq, H, W, 3]`, by central differences of these steps `[nq]`."""
        moved = [(q + s * e, q - s * e) for s, e in zip(steps, np.eye(len(q)), strict=True)]
        return np.stack(
            [
                (self.render(forward, values, soft) - self.render(back, values, soft)) / np.float32(2 * s)
                for (forward, back), s in zip(moved, steps, strict=True)
            ]
        )

    def look_jacobian(self, q: Array, values: Array, soft: float = 0.0) -> Image:
        """Derivative to the look, `[p, H, W, 3]`, by central differences."""
        out = []
        for k, step in enumerate(self._look_steps()):
            after, before = values.copy(), values.copy()
            after[k] += step
            before[k] -= step if k < len(values) - 1 else min(step, values[-1])  # a variance is not negative
            width = np.float32(after[k] - before[k])
            out.append((self.render(q, after, soft) - self.render(q, before, soft)) / width)
        return np.stack(out)

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

    def _visible(self, joint: int) -> tuple[float, float]:
        """How far a slide moves until its body leaves the image, m, from its zero."""
        q, size = np.zeros(self.model.nq), max(self.size)
        there = self._points(q, self.nominal)
        q[joint] = 1e-2
        per_metre = float(np.abs(self._points(q, self.nominal) - there).max()) / 1e-2
        reach = size / 2 / max(per_metre, 1e-3)
        return -reach, reach

    def _look_steps(self) -> Array:
        """Steps of finite differences: each moves what is seen by about `STEP` pixels."""
        half = max(self.size) / 2
        pixels = [1.0, 1.0, half, half, half, *[half / 2] * (len(self.parameters) - len(CAMERA) - 1)]
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

    def _points(self, q: Array, values: Array) -> Array:
        """Pixels `[G, 2]` of the ends of all geoms that move."""
        self._place(q, values)
        model, data = self._drawn, self._data
        moving = np.flatnonzero(model.body_weldid[model.geom_bodyid] > 0)
        axis = data.geom_xmat.reshape(-1, 3, 3)[moving, :, 2]
        reach = np.where(model.geom_type[moving] == mujoco.mjtGeom.mjGEOM_SPHERE, 0, model.geom_size[moving, 1])
        ends = np.concatenate([data.geom_xpos[moving] + sign * reach[:, None] * axis for sign in (-1, 1)])
        height, width = self.size
        seen = world_to_image(model, data, ends, self._camera, width, height)
        return seen * [(width - 1) / 2, (height - 1) / 2]
