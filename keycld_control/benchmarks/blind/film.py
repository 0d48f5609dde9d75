"""What a camera that is not quite the simulator's shows of a sealed case."""

import io
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import imageio.v3 as iio
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from keycld_control.benchmarks.blind.parameter_errors import ParameterErrors
from keycld_envs.rendering import Renderer, View
from keycld_envs.systems import get_system

Array = NDArray[np.float64]
SIZE = 64
"""Width and height of frames, pixels."""
RATE = 50.0
"""Frames per second."""
SHIFTED = 1 / 3
"""Share of the cases in which frames look otherwise, too: light, noise and compression."""


@dataclass(frozen=True)
class Film:
    """A camera and its light.

    Attributes:
        right: shift of the image, pixels.
        up: shift of the image, pixels.
        zoom: factor of lengths.
        aspect: factor of horizontal lengths beside it.
        roll: rad.
        blur: standard deviation of a Gaussian, pixels.
        gain: of red, green and blue.
        offset: grey levels.
        noise: standard deviation of every pixel, grey levels.
        jpeg: quality of the compression, None for none.
        shifted: light, noise and compression are far from the simulator's.
    """

    right: float
    up: float
    zoom: float
    aspect: float
    roll: float
    blur: float
    gain: tuple[float, float, float]
    offset: float
    noise: float
    jpeg: int | None
    shifted: bool

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
            shifted=shifted,
        )

    def answer(self) -> dict[str, Any]:
        """All numbers."""
        return asdict(self)

    @cached_property
    def view(self) -> View:
        """As the renderer takes it."""
        return View(self.right, self.up, self.zoom, self.aspect, self.roll)

    def develop(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """What the camera makes of an ideal image."""
        out = gaussian_filter(image.astype(np.float64), (self.blur, self.blur, 0))
        out = out * self.gain + self.offset + rng.normal(0, self.noise, image.shape)
        frame = np.clip(np.round(out), 0, 255).astype(np.uint8)
        if self.jpeg is None:
            return frame
        with io.BytesIO() as file:
            iio.imwrite(file, frame, extension=".jpg", quality=self.jpeg)
            return np.asarray(iio.imread(file.getvalue(), extension=".jpg"))


def _gain(light: float, spread: float, rng: np.random.Generator) -> tuple[float, float, float]:
    """Of three colours, which differ from the light by a spread."""
    red, green, blue = (light * float(g) for g in np.exp(rng.normal(0, spread, 3)))
    return red, green, blue


class Studio:
    """Films one system, whose links are as long as they are."""

    def __init__(self, system: str, errors: ParameterErrors) -> None:
        """Opens OpenGL."""
        declared = get_system(system)
        self._camera, self._model = declared.camera, declared.compile()
        lengthen(self._model, errors)
        self._data = mujoco.MjData(self._model)
        self._renderer = Renderer(self._model, SIZE, SIZE, "fast")

    def __enter__(self) -> "Studio":
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def shoot(self, positions: Array, film: Film, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Frames `[T, H, W, 3]` of positions `[T, nv]`."""
        out = []
        for q in positions:
            self._data.qpos[:] = q
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_camlight(self._model, self._data)
            out.append(film.develop(self._renderer.render(self._data, self._camera, film.view), rng))
        return np.stack(out)


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
