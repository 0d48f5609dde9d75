"""Pixels of a MuJoCo scene, with a choice between exactness and speed."""

import atexit
import copy
import weakref
from dataclasses import dataclass, replace
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from keycld_envs.checks import check_size
from keycld_envs.opengl import create_context, no_opengl

Array = NDArray[np.float64]
Quality = Literal["fast", "full"]


@dataclass(frozen=True)
class RenderSettings:
    """What software rendering spends its time on, each None to keep the model's own.

    Attributes:
        shadow_size: side of the shadow map, texels.
        slices: sides of the polygons that stand for circles in capsules, cylinders, and spheres.
        stacks: rings of a sphere.
        plane_cells: upper bound on the cells along a plane's side; lighting is computed at their corners.
    """

    shadow_size: int | None = None
    slices: int | None = None
    stacks: int | None = None
    plane_cells: int | None = None

    def apply(self, model: mujoco.MjModel) -> mujoco.MjModel:
        """A copy of `model` with these settings, from which OpenGL's resources can be made."""
        changed = copy.copy(model)
        quality = changed.vis.quality
        quality.shadowsize = self.shadow_size or quality.shadowsize
        quality.numslices = self.slices or quality.numslices
        quality.numstacks = self.stacks or quality.numstacks
        if self.plane_cells:
            planes = changed.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
            coarsest = 2 * changed.geom_size[planes, :2].max(axis=1) / self.plane_cells
            changed.geom_size[planes, 2] = np.maximum(changed.geom_size[planes, 2], coarsest)
        return changed


@dataclass(frozen=True)
class View:
    """How a camera sees otherwise than its model says, without any interpolation of pixels.

    Attributes:
        right: image content is shifted to the right, pixels.
        up: and upwards, pixels.
        zoom: factor of all lengths in the image.
        aspect: factor of horizontal lengths beside `zoom`.
        roll: image content is turned counter-clockwise about the centre, rad.
        pitch: the camera is turned upwards where it stands, rad, and what was in the middle of the image stays there:
            lengths shrink towards the top (keystone). It does nothing to orthographic cameras.
        yaw: the same to the right.
        aside: the camera stands farther right, by so much of `distance`, and what is so far away stays in place: what
            is behind it moves to the right (parallax). It does nothing to orthographic cameras, either.
        above: the same upwards.
        nearer: the same forwards; what is so far away stays as large.
        distance: from the model's camera, along its axis, m.
    """

    right: float = 0.0
    up: float = 0.0
    zoom: float = 1.0
    aspect: float = 1.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    aside: float = 0.0
    above: float = 0.0
    nearer: float = 0.0
    distance: float = 1.0

    def apply(self, scene: mujoco.MjvScene, width: int, height: int) -> None:
        """Change the cameras of a scene, both eyes, and the headlight, which is where they are."""
        for camera in scene.camera:
            if not camera.orthographic:
                self._move(camera)
            self._turn(camera)
            half = 0.5 * (camera.frustum_top - camera.frustum_bottom) / self.zoom  # of the height, at the near plane
            wide = half * width / height / self.aspect
            camera.frustum_width = wide
            camera.frustum_center -= 2 * wide * self.right / width
            shift = 2 * half * self.up / height
            middle = 0.5 * (camera.frustum_top + camera.frustum_bottom)
            camera.frustum_bottom, camera.frustum_top = middle - half - shift, middle + half - shift
        for light in scene.lights[: scene.nlight]:
            if light.headlight:
                light.pos[:] = np.mean([camera.pos for camera in scene.camera], axis=0)
                light.dir[:] = scene.camera[0].forward

    def place(self, right: ArrayLike, up: ArrayLike, focal: float) -> tuple[Array, Array]:
        """Where content at `distance` is seen, pixels to the right of the middle and above it.

        Args:
            right: of the middle, where the model's camera sees it, pixels.
            up: and above it.
            focal: length of the camera, pixels; infinite for an orthographic one.
        """
        x, y = np.asarray(right, np.float64), np.asarray(up, np.float64)
        if np.isfinite(focal):
            depth = np.full_like(x, 1 - self.nearer)
            seen, middle = (
                np.einsum("ij,j...->i...", self._turned, np.stack([right - self.aside, up - self.above, depth]))
                for right, up in ((x / focal, y / focal), (0.0 * x, 0.0 * y))
            )
            x, y = (focal * (1 - self.nearer) * (seen[k] / seen[2] - middle[k] / middle[2]) for k in (0, 1))
        x, y = x * np.cos(self.roll) - y * np.sin(self.roll), x * np.sin(self.roll) + y * np.cos(self.roll)
        return x * self.zoom * self.aspect + self.right, y * self.zoom + self.up

    def far_in_place(self, right: float, up: float, zoom: float, focal: float) -> "View":
        """With another shift and zoom, from where all that is far away is seen where it was; the mechanism moves.

        Args:
            right: shift of what is at `distance`, pixels.
            up: and upwards.
            zoom: factor of its lengths.
            focal: length of the camera, pixels.
        """
        nearer = 1 - self.zoom * (1 - self.nearer) / zoom
        x, y = (right - self.right) / self.aspect, up - self.up
        turned = np.array(
            [x * np.cos(self.roll) + y * np.sin(self.roll), y * np.cos(self.roll) - x * np.sin(self.roll)]
        )
        middle = self._turned @ np.array([-self.aside, -self.above, 1 - self.nearer])
        shifted = middle[:2] / middle[2] + turned / (focal * zoom * (1 - nearer))
        aside, above, ahead = self._turned.T @ np.array([*shifted, 1.0])
        aside, above = (-(1 - nearer) * float(axis / ahead) for axis in (aside, above))
        return replace(self, right=right, up=up, zoom=zoom, aside=aside, above=above, nearer=nearer)

    @property
    def _turned(self) -> Array:
        """Right, up and forward of the camera after yaw and pitch `[3, 3]`, in those before."""
        (cy, sy), (cp, sp) = ((np.cos(angle), np.sin(angle)) for angle in (self.yaw, self.pitch))
        return np.array([[cy, 0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]])

    def _move(self, camera: mujoco.MjvGLCamera) -> None:
        """Aside, above and nearer, and a shift and a zoom by which what is at `distance` stays in place."""
        axes = np.stack([_cross(camera.forward, camera.up), camera.up, camera.forward])
        camera.pos[:] = camera.pos + self.distance * np.array([self.aside, self.above, self.nearer]) @ axes
        larger, near = 1 / (1 - self.nearer), camera.frustum_near
        camera.frustum_center = larger * (camera.frustum_center - near * self.aside)
        camera.frustum_bottom = larger * (camera.frustum_bottom - near * self.above)
        camera.frustum_top = larger * (camera.frustum_top - near * self.above)

    def _turn(self, camera: mujoco.MjvGLCamera) -> None:
        """Yaw, pitch and roll, and a shift by which what was in the middle stays there."""
        forward = np.array(camera.forward, np.float64)
        before = np.stack([_cross(forward, camera.up), camera.up, forward])
        off = camera.frustum_center, 0.5 * (camera.frustum_bottom + camera.frustum_top)
        middle = np.array([*off, camera.frustum_near]) @ before
        right, up, ahead = before if camera.orthographic else self._turned @ before
        right, up = (
            np.cos(self.roll) * right - np.sin(self.roll) * up,
            np.cos(self.roll) * up + np.sin(self.roll) * right,
        )
        camera.forward[:], camera.up[:] = ahead, up
        if not camera.orthographic:
            x, y = (camera.frustum_near * float(axis @ middle / (ahead @ middle)) for axis in (right, up))
            camera.frustum_center = x
            camera.frustum_bottom += y - off[1]
            camera.frustum_top += y - off[1]


def _cross(a: ArrayLike, b: ArrayLike) -> Array:
    """The vector product of two vectors, without what makes `np.cross` slow: each drawing needs four."""
    (x, y, z), (u, v, w) = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


QUALITIES: dict[str, RenderSettings] = {
    "full": RenderSettings(),
    "fast": RenderSettings(shadow_size=128, slices=16, stacks=8, plane_cells=20),
}

_open_renderers: "weakref.WeakSet[Renderer]" = weakref.WeakSet()


def _close_all() -> None:
    for renderer in list(_open_renderers):
        renderer.close()


class Renderer:
    """Renders one model at one size; opens OpenGL when constructed, frees it in `close`.

    Args:
        model: the compiled model.
        width: W, pixels.
        height: H, pixels.
        quality: "full" renders exactly as dm_control does. "fast" uses a small shadow map and coarser round shapes;
            it differs from "full" by less than 0.5 of 255 grey levels on average (64 x 64 pixels).

    Raises:
        InputError: if no OpenGL context can be opened.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, quality: Quality = "fast") -> None:
        self._gl: Any = None
        resources = QUALITIES[quality].apply(model)
        resources.vis.global_.offwidth, resources.vis.global_.offheight = width, height
        gl = create_context(width, height)
        try:
            self._context = mujoco.MjrContext(resources, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except mujoco.FatalError as error:
            gl.free()
            raise no_opengl(str(error)) from error
        self._gl = gl
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        if not _open_renderers:
            atexit.unregister(_close_all)
            atexit.register(_close_all)  # after the context, so that it runs before the backend shuts down
        _open_renderers.add(self)
        self._model = model
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._pixels = np.empty((height, width, 3), np.uint8)

    def render(self, data: mujoco.MjData, camera: str, view: View | None = None) -> NDArray[np.uint8]:
        """Render the state `data`, whose kinematics must be up to date.

        Args:
            data: the state.
            camera: name of a camera of the model.
            view: how it sees otherwise than the model says.

        Returns:
            [H, W, 3] RGB, a new array; row 0 is the top.
        """
        self._gl.make_current()
        self._camera.fixedcamid = self._model.camera(camera).id
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        if view is not None:
            view.apply(self._scene, self._rect.width, self._rect.height)
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(self._pixels, None, self._rect, self._context)
        return self._pixels[::-1].copy()

    def close(self) -> None:
        """Free the OpenGL resources; may be called twice."""
        if self._gl is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._gl = None
            _open_renderers.discard(self)

    def __del__(self) -> None:
        self.close()


def describe_camera(model: mujoco.MjModel, data: mujoco.MjData, name: str, width: int, height: int) -> dict[str, Any]:
    """What a recording's `camera` says of a camera: where it is, and how much it sees."""
    camera = model.camera(name).id
    return {
        "name": name,
        "width": width,
        "height": height,
        "position": data.cam_xpos[camera].tolist(),
        "rotation": data.cam_xmat[camera].reshape(3, 3).tolist(),
        "fovy": float(model.cam_fovy[camera]),
    }


class Renderers:
    """Renderers of one model, one for each size that is asked for.

    Args:
        model: the compiled model.
        quality: of all of them, see `Renderer`.
    """

    def __init__(self, model: mujoco.MjModel, quality: Quality) -> None:
        self._model = model
        self._quality: Quality = quality
        self._open: dict[tuple[int, int], Renderer] = {}

    def of_size(self, width: int, height: int) -> Renderer:
        """The one of a size in pixels, opened when it is first asked for."""
        width, height = check_size("width", width), check_size("height", height)
        if (width, height) not in self._open:
            self._open[width, height] = Renderer(self._model, width, height, self._quality)
        return self._open[width, height]

    def close(self) -> None:
        """Free them all; they open again when asked for."""
        while self._open:
            self._open.popitem()[1].close()
