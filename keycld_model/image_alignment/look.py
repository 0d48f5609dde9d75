"""What an image depends on beside the joints: the camera, visible lengths, and sharpness."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.rendering import View
from keycld_model.rigid_body.links import rigid

Array = NDArray[np.float64]
CAPSULES = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))


@dataclass(frozen=True)
class LookParameter:
    """A number that an image depends on.

    Attributes:
        name: such as "zoom" or "visible length of upper_arm".
        spread: standard deviation expected of it.
        unit: of its value.
        factor: the value is the logarithm of a factor.
        body: whose length it is; None for the camera.
    """

    name: str
    spread: float
    unit: str
    factor: bool = False
    body: int | None = None

    @property
    def label(self) -> str:
        """Its name, and that it is the camera's if so."""
        return self.name if self.body is not None else f"camera: {self.name}"


PARALLAX = ("aside", "above", "nearer")
"""Parameters of the camera that move what is behind the mechanism, and not the mechanism."""
CAMERA = ("right", "up", "zoom", "aspect", "roll", "pitch", "yaw", *PARALLAX)
"""The first parameters, those of `View`."""
BLUR = "blur"
"""The last one: the variance of a Gaussian that an image is blurred by, which differences are linear in."""


def look_parameters(model: mujoco.MjModel, size: tuple[int, int]) -> tuple[LookParameter, ...]:
    """Of a model whose images have a size (H, W): ten of the camera, a length of every link that turns, and blur."""
    turning = [int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
    return (
        LookParameter("right", 0.05 * size[1], "px"),
        LookParameter("up", 0.05 * size[0], "px"),
        LookParameter("zoom", 0.1, "of the simulator's", factor=True),
        LookParameter("aspect", 0.05, "of the simulator's", factor=True),
        LookParameter("roll", 0.1, "rad"),
        LookParameter("pitch", 0.05, "rad"),
        LookParameter("yaw", 0.05, "rad"),
        *(LookParameter(name, 0.05, "of the distance") for name in PARALLAX),
        *(
            LookParameter(f"visible length of {model.body(b).name}", 0.15, "of the simulator's", True, b)
            for b in dict.fromkeys(turning)
        ),
        LookParameter(BLUR, 0.5, "px^2"),
    )


def view_of(values: Array, distance: float = 1.0) -> View:
    """How the camera sees, of the values of all parameters; as the simulator's, if there are none.

    Args:
        values: `[p]`.
        distance: of the mechanism from the simulator's camera, m.
    """
    if not len(values):
        return View()
    right, up, zoom, aspect, *angles = (float(v) for v in values[: len(CAMERA)])
    return View(right, up, float(np.exp(zoom)), float(np.exp(aspect)), *angles, distance=distance)


def pixels_of(points: Array, values: Array, size: tuple[int, int], focal: float) -> Array:
    """Columns and rows `[..., 2]` of pixels at which image units `[..., 2]` of the simulator's camera are seen.

    Args:
        points: pixel centres of the simulator's image span -1 to 1, y up.
        values: of all parameters.
        size: of the image, (H, W).
        focal: length of the simulator's camera, see `keycld_envs.projection.focal_length`.
    """
    height, width = size
    x, y = points[..., 0] * (width - 1) / 2, points[..., 1] * (height - 1) / 2
    x, y = view_of(values).place(x, y, focal)
    return np.stack([(width - 1) / 2 + x, (height - 1) / 2 - y], axis=-1)


def as_seen(model: mujoco.MjModel, parameters: tuple[LookParameter, ...], values: Array) -> mujoco.MjModel:
    """A copy of a model whose links are as long as they look."""
    out = copy.copy(model)
    for parameter, value in zip(parameters, values, strict=True):
        if parameter.body is not None:
            lengthen(out, parameter.body, float(np.exp(value)))
    return out


def lengthen(model: mujoco.MjModel, body: int, factor: float) -> None:
    """Scale a link as it is seen, in place: where its geoms and the next links are, and how long capsules are."""
    own = rigid(model, body)
    model.body_pos[np.isin(model.body_parentid, own) & (np.arange(model.nbody) > 0)] *= factor
    geoms = np.isin(model.geom_bodyid, own)
    model.geom_pos[geoms] *= factor
    model.geom_sameframe[geoms] = 0  # else MuJoCo puts a geom where the body's centre of mass is
    model.geom_size[geoms & np.isin(model.geom_type, CAPSULES), 1] *= factor
