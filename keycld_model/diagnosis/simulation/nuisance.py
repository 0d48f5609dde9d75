"""What is never missing physics: masses and lengths that are a little off, zeros of encoders, errors of a camera."""

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.rigid_body.equality import anchors, bodies, connections

MASS_SPREAD, LENGTH_SPREAD = 0.12, 0.12
"""Standard deviations expected of the logarithms of masses and lengths."""
ZERO_SPREAD = 0.015
"""Standard deviation expected of an encoder's zero, rad or m."""
VIEW_SPREAD, SHUTTER_SPREAD = 0.03, 0.01
"""Standard deviations expected of what a camera that looks askew adds to a position, rad or m, and of the time, s, that
its shutter takes to roll from one line of the image to another."""
CAMERA: dict[Literal["squash", "skew", "shutter"], float] = {
    "squash": VIEW_SPREAD,
    "skew": VIEW_SPREAD,
    "shutter": SHUTTER_SPREAD,
}
"""Its errors, and their standard deviations."""

HINGE = {"zero": "rad", "squash": "rad", "skew": "rad", "shutter": "s"}
SLIDE = {"zero": "m", "squash": "1", "skew": "1/m", "shutter": "s/m"}
"""Units of what is added to a position."""


@dataclass(frozen=True)
class Nuisance:
    """A number that is refitted before anything is called missing.

    Attributes:
        name: for instance "mass of upper_arm".
        kind: "mass" and "length" are logarithms of factors, "zero" is in rad or m; "squash", "skew" and "shutter" are
            errors of a camera, see `seen`.
        index: body, or joint.
        spread: standard deviation expected of it.
        unit: of what is reported.
    """

    name: str
    kind: Literal["mass", "length", "zero", "squash", "skew", "shutter"]
    index: int
    spread: float
    unit: str = "of the simulator's"

    @property
    def factor(self) -> bool:
        """It is the logarithm of a factor of the simulator's own number."""
        return self.kind in ("mass", "length")

    @property
    def scale(self) -> float:
        """Step of derivatives."""
        return 0.01 if self.factor else 0.02 * self.spread


def nuisances(model: mujoco.MjModel, tracked: bool = False) -> tuple[Nuisance, ...]:
    """Those of a model: a mass and a length per body with joints, a zero per joint.

    If positions were `tracked` in images, errors of the camera at each joint as well.
    """
    bodies = [b for b in range(1, model.nbody) if model.body_dofnum[b]]
    turning = [b for b in bodies if (model.jnt_type[model.body_jntadr[b]] == mujoco.mjtJoint.mjJNT_HINGE)]
    units = [HINGE if kind == mujoco.mjtJoint.mjJNT_HINGE else SLIDE for kind in model.jnt_type]
    return (
        *(Nuisance(f"mass of {model.body(b).name}", "mass", b, MASS_SPREAD) for b in bodies),
        *(Nuisance(f"length of {model.body(b).name}", "length", b, LENGTH_SPREAD) for b in turning),
        *(
            Nuisance(f"zero of {model.joint(j).name}", "zero", j, ZERO_SPREAD, unit["zero"])
            for j, unit in enumerate(units)
        ),
        *(
            Nuisance(f"{kind} of {model.joint(j).name}", kind, j, spread, units[j][kind])
            for j in (range(model.njnt) if tracked else ())
            for kind, spread in CAMERA.items()
        ),
    )


def seen(
    model: mujoco.MjModel,
    which: tuple[Nuisance, ...],
    values: NDArray[np.float64],
    q: NDArray[np.float64],
    v: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Measured positions `[..., nv]` for true ones and velocities.

    A plane that is seen askew is squashed along some direction: to first order angles are off by sin 2q and cos 2q, and
    slides by q and q². A shutter that rolls across the image sees a joint earlier or later by where it is.
    """
    out = q.copy()
    for nuisance, value in zip(which, values, strict=True):
        if nuisance.factor:
            continue
        j = nuisance.index
        turns = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
        at, speed = q[..., j], v[..., j]
        if nuisance.kind == "zero":
            out[..., j] += value
        elif nuisance.kind == "squash":
            out[..., j] += value * (np.sin(2 * at) if turns else at)
        elif nuisance.kind == "skew":
            out[..., j] += value * (np.cos(2 * at) - 1 if turns else at**2)
        elif nuisance.kind == "shutter":
            out[..., j] += value * speed * (np.sin(at) if turns else at)
    return out


def apply(model: mujoco.MjModel, which: tuple[Nuisance, ...], values: NDArray[np.float64]) -> None:
    """Change a compiled model in place; zeros and cameras are no business of the model."""
    for nuisance, value in zip(which, values, strict=True):
        factor = float(np.exp(value))
        for body in rigid(model, nuisance.index) if nuisance.factor else ():
            if nuisance.kind == "mass":
                model.body_mass[body] *= factor
                model.body_inertia[body] *= factor
            else:
                model.body_ipos[body] *= factor
                model.body_inertia[body] *= factor**2
        if nuisance.kind == "length":
            own = rigid(model, nuisance.index)
            moved = np.isin(model.body_parentid, own)
            moved[0] = False
            model.body_pos[moved] *= factor
            _lengthen(model, own, factor)


def rigid(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and what is fixed to it."""
    out = [body]
    for child in range(body + 1, model.nbody):
        if model.body_parentid[child] in out and not model.body_dofnum[child]:
            out.append(child)
    return out


def _lengthen(model: mujoco.MjModel, own: list[int], factor: float) -> None:
    """Scale the points of bodies at which loops are closed."""
    model.site_pos[np.isin(model.site_bodyid, own)] *= factor
    for i in connections(model):
        if model.eq_objtype[i] != int(mujoco.mjtObj.mjOBJ_SITE):
            for body, anchor in zip(bodies(model, i), anchors(model, i), strict=True):
                if body in own:
                    anchor *= factor
