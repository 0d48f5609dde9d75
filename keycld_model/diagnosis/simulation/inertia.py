"""Masses and lengths that are a little off: nuisances of every simulator."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.delan.rig import ALL_LINKS, OWN_ERROR, deviation, learned_dynamics
from keycld_model.diagnosis.criteria import STANDARD, Criteria
from keycld_model.diagnosis.inputs.observation import Nuisance
from keycld_model.rigid_body.equality import anchors, bodies, connections
from keycld_model.rigid_body.links import rigid


def inertial_nuisances(model: mujoco.MjModel, criteria: Criteria = STANDARD) -> tuple[Nuisance, ...]:
    """A mass per body with joints, a length per body that turns; of a joint model, a factor of all, and own errors."""
    if learned_dynamics(model) is not None:
        body = int(model.body(ALL_LINKS).id)
        factor = Nuisance(f"mass of {ALL_LINKS}", "mass", body, criteria.spreads.mass, factor=True)
        unit = "of the model's usual torque"
        own = (
            Nuisance(f"{OWN_ERROR} {k + 1}", "own error", k, criteria.spreads.mass, unit)
            for k in range(len(deviation(model)))
        )
        return factor, *own
    jointed = [b for b in range(1, model.nbody) if model.body_dofnum[b]]
    turning = [b for b in jointed if (model.jnt_type[model.body_jntadr[b]] == mujoco.mjtJoint.mjJNT_HINGE)]
    wanted = [("mass", b) for b in jointed] + [("length", b) for b in turning]
    return tuple(
        Nuisance(f"{kind} of {model.body(b).name}", kind, b, criteria.spreads.mass, factor=True) for kind, b in wanted
    )


def apply(model: mujoco.MjModel, which: tuple[Nuisance, ...], values: NDArray[np.float64]) -> None:
    """Change masses and lengths of a compiled model in place, by logarithms of factors; own errors by themselves."""
    for nuisance, value in zip(which, values, strict=True):
        if nuisance.kind == "own error":
            deviation(model)[nuisance.index] = value
            continue
        factor = float(np.exp(value))
        for body in rigid(model, nuisance.index):
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


def _lengthen(model: mujoco.MjModel, own: list[int], factor: float) -> None:
    """Scale the points of bodies at which loops are closed."""
    model.site_pos[np.isin(model.site_bodyid, own)] *= factor
    for i in connections(model):
        if model.eq_objtype[i] != int(mujoco.mjtObj.mjOBJ_SITE):
            for body, anchor in zip(bodies(model, i), anchors(model, i), strict=True):
                if body in own:
                    anchor *= factor
