"""The force of an effect along the motion: its shape, and the positions and speeds to which it is confined."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import Effect
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.estimation.fit import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """A force at one joint, along the motion of training recordings.

    Attributes:
        joint: its name.
        turns: it is a hinge.
        position: `[K]` rad, within pi of their mean direction, or m.
        speed: `[K]` rad/s or m/s.
        force: `[K]` N m or N.
    """

    joint: str
    turns: bool
    position: Array
    speed: Array
    force: Array

    def region(self, criteria: Criteria) -> dict[str, tuple[float, float]] | None:
        """Positions and speeds to which the force is confined; see `Finding`.

        The shortest interval that holds most of the squared force is compared with the shortest that holds as much of
        the time.
        """
        out, weight = {}, self.force**2
        for signal, values in (("qpos", self.position), ("qvel", self.speed)):
            if weight.sum() == 0:
                continue
            low, high = _shortest(values, weight, criteria.region)
            begin, end = _shortest(values, np.ones_like(values), criteria.region)
            if high - low < criteria.confined * (end - begin):
                out[f"{signal}:{self.joint}"] = (round(low, 4), round(high, 4))
        return out or None


def shape_of(fit: Fit, effect: Effect) -> Shape | None:
    """Of an effect that is nothing but a force at a joint, and has no memory; None for others."""
    model, point = fit.problem.simulator.model, fit.point
    partly = type(effect).edit is not Effect.edit
    if effect.kind != "joint" or partly or not effect.forces or effect.memory:
        return None
    windows, (q, v, u) = fit.problem.windows, fit.problem.path(point)
    q, v = q[:, :-1], v[:, :-1]
    t = windows.begun[:, None] + windows.step * np.arange(q.shape[1])
    edited = fit.problem.simulator.compile(point.variant)
    joint = model.joint(effect.where).id
    force = effect.force(edited, t, q, v, u)[..., joint].ravel()
    position, turns = q[..., joint].ravel(), bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE)
    if turns:
        middle = float(np.angle(np.mean(np.exp(1j * position))))
        position = middle + (position - middle + np.pi) % (2 * np.pi) - np.pi
    return Shape(effect.where, turns, position, v[..., joint].ravel(), force)


def _shortest(values: Array, weight: Array, share: float) -> tuple[float, float]:
    """The shortest interval of values that holds a share of the weight."""
    order = np.argsort(values)
    x, total = values[order], np.concatenate([[0.0], np.cumsum(weight[order])])
    last = np.searchsorted(total, total[:-1] + share * total[-1] * (1 - 1e-9))  # first sum that is enough, from each
    fits = last < len(total)
    begin = np.flatnonzero(fits)
    best = int(begin[np.argmin(x[last[fits] - 1] - x[begin])])
    return float(x[best]), float(x[last[best] - 1])
