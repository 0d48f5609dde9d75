"""What is never missing physics: masses and lengths that are a little off, and zeros of encoders."""

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.loops import anchors, bodies, connections

MASS_SPREAD, LENGTH_SPREAD = 0.12, 0.12
"""Standard deviations expected of the logarithms of masses and lengths."""
ZERO_SPREAD = 0.015
"""Standard deviation expected of an encoder's zero, rad or m."""


@dataclass(frozen=True)
class Nuisance:
    """A number that is refitted before anything is called missing.

    Attributes:
        name: for instance "mass of upper_arm".
        kind: "mass" and "length" are logarithms of factors, "zero" is in rad or m.
        index: body, or joint.
        spread: standard deviation expected of it.
    """

    name: str
    kind: Literal["mass", "length", "zero"]
    index: int
    spread: float

    @property
    def scale(self) -> float:
        """Step of derivatives."""
        return 0.02 * self.spread if self.kind == "zero" else 0.01


def nuisances(model: mujoco.MjModel) -> tuple[Nuisance, ...]:
    """Those of a model: a mass and a length per body with joints, a zero per joint."""
    bodies = [b for b in range(1, model.nbody) if model.body_dofnum[b]]
    turning = [b for b in bodies if (model.jnt_type[model.body_jntadr[b]] == mujoco.mjtJoint.mjJNT_HINGE)]
    joints = range(model.njnt)
    return (
        *(Nuisance(f"mass of {model.body(b).name}", "mass", b, MASS_SPREAD) for b in bodies),
        *(Nuisance(f"length of {model.body(b).name}", "length", b, LENGTH_SPREAD) for b in turning),
        *(Nuisance(f"zero of {model.joint(j).name}", "zero", j, ZERO_SPREAD) for j in joints),
    )


def apply(model: mujoco.MjModel, which: tuple[Nuisance, ...], values: NDArray[np.float64]) -> None:
    """Change a compiled model in place; zeros are no business of the model."""
    for nuisance, value in zip(which, values, strict=True):
        factor = float(np.exp(value))
        for body in rigid(model, nuisance.index) if nuisance.kind != "zero" else ():
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
