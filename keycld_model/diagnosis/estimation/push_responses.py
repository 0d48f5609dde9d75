"""How residuals would fall with a push, at every joint and in every part of a window."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.simulation.simulator import usual_forces

Array = NDArray[np.float64]


def push_responses(problem: Problem, point: Point, joints: Sequence[int], bins: int) -> Array:
    """How residuals fall with a push at a joint during one of several parts of each window.

    Args:
        problem: windows and a simulator.
        point: where.
        joints: J of them, among the velocities.
        bins: B parts of a window.

    Returns:
        Change of whitened residuals per N m or N, `[W, r, J, B]`.
    """
    steps, nv = problem.windows.steps, point.q.shape[1]
    sizes, edges = usual_forces(problem.simulator.model)[list(joints)], problem.windows.edges(bins)
    pushes = np.zeros((len(joints), bins, len(problem.windows), steps, nv))
    for j, joint in enumerate(joints):
        for b in range(bins):
            pushes[j, b, :, edges[b] : edges[b + 1], joint] = sizes[j]
    pushes = np.concatenate([np.zeros((1, *pushes.shape[2:])), pushes.reshape(-1, *pushes.shape[2:])])
    q, v = (np.repeat(z[None], len(pushes), axis=0) for z in (point.q, point.v))
    here, *pushed = problem.whiten(problem.predict([point.variant], np.zeros(len(pushes), int), q, v, pushes))
    columns = (here - np.stack(pushed)).reshape(len(joints), bins, *here.shape) / sizes[:, None, None, None]
    return np.moveaxis(columns, (0, 1), (2, 3))
