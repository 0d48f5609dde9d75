"""How far positions are off that were read with a look that is not quite the camera's."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from keycld_model.image_alignment.look import BLUR, PARALLAX, LookParameter
from keycld_model.image_alignment.scene import Scene

Array = NDArray[np.float64]
RIDGE = 1e-3
"""Of the mean square of a term: poses that all are alike do not tell its coefficient."""


class Change(NamedTuple):
    """At some positions.

    Attributes:
        q: `[nq]` rad or m.
        of_look: `[nq, p]` change of them per unit of each parameter of the look.
    """

    q: Array
    of_look: Array


@dataclass(frozen=True)
class LookErrors:
    """Changes of positions with the parameters of a look, to first order, at any positions.

    A polynomial of the second degree in the sines and cosines of the angles of links, and in slides; of higher ones,
    poses that they were not fitted to show nothing.

    Attributes:
        parameters: of the look, but for blur and parallax, which do not move a mechanism.
        hinges: `[nq]` whether a joint is one.
        coefficients: `[terms, nq, p]` rad or m per standard deviation.
    """

    parameters: tuple[LookParameter, ...]
    hinges: NDArray[np.bool_]
    coefficients: Array

    @classmethod
    def of(
        cls,
        parameters: tuple[LookParameter, ...],
        deviation: Array,
        hinges: NDArray[np.bool_],
        changes: Sequence[Change],
    ) -> Self:
        """Fitted to changes at some positions, see `change_by_look`.

        Args:
            parameters: of a look.
            deviation: `[p]` standard deviations of their values.
            hinges: `[nq]` whether a joint is one.
            changes: at the positions.
        """
        seen = [k for k, parameter in enumerate(parameters) if parameter.name not in (BLUR, *PARALLAX)]
        terms = _terms(np.stack([change.q for change in changes]), hinges)
        scaled = np.stack([change.of_look for change in changes])[..., seen] * deviation[seen]
        normal = terms.T @ terms + RIDGE * len(terms) * np.eye(terms.shape[1])
        found = np.linalg.solve(normal, terms.T @ scaled.reshape(len(terms), -1))
        shaped = np.asarray(found.reshape(-1, *scaled.shape[1:]), np.float64)
        return cls(tuple(parameters[k] for k in seen), hinges, shaped)

    def __call__(self, q: Array, values: Array) -> Array:
        """Of positions `[..., nq]`, rad or m, where parameters are off by `[p]` standard deviations."""
        return _terms(q, self.hinges) @ (self.coefficients @ values)


def change_by_look(scene: Scene, look: Array, q: Array) -> Change:
    """What a change of the look does to positions that are read off a frame.

    Least squares on the difference between two drawings: joints undo what a change of the look does, as far as they
    can.

    Args:
        scene: that draws.
        look: `[p]` of the scene.
        q: `[nq]` positions, rad or m.
    """
    there = scene.render(q, look)
    of_look = scene.look_jacobian(q, look, there).first
    of_joints = scene.jacobian(q, look, scene.joint_steps(q, look), there).first
    a, b = (np.asarray(first, np.float64).reshape(len(first), -1).T for first in (of_look, of_joints))
    return Change(q, -np.asarray(np.linalg.lstsq(b, a, rcond=None)[0], np.float64))


def _terms(q: Array, hinges: NDArray[np.bool_]) -> Array:
    """One, sines and cosines of links' angles, slides, and products of two of these, `[..., terms]`."""
    angle, first = np.zeros(q.shape[:-1]), [np.ones(q.shape[:-1])]
    for j, hinge in enumerate(hinges):
        if hinge:
            angle = angle + q[..., j]  # of the link, in the plane
        first += [np.sin(angle), np.cos(angle)] if hinge else [q[..., j]]
    return np.stack([a * b for a, b in itertools.combinations_with_replacement(first, 2)], axis=-1)
