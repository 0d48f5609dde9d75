"""Joint positions of one frame: Gauss-Newton on the difference between what is shown and what is drawn."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.scene import STEP, Scene, softened

Array = NDArray[np.float64]
Image = NDArray[np.float32]
ACTIVE = 0.05
"""Pixels count where they change with a joint by this share of the strongest change, or more."""
FINEST = 2.0
"""Grey levels: rounding, and edges drawn in a few shades; residuals are never weighed as if they were finer."""
OUTLIER = 3.0
"""Residuals of more robust standard deviations count linearly (Huber)."""
EDGE = 25.0
"""Grey levels; an edge a fraction of a pixel away leaves as much, and is no outlier."""
SOFT = (2.0, 0.7)
"""Pixels by which images are softened, one after the other, before a pose that may be pixels away is fitted to them as
they are: differences are then linear over that far."""
FAR = 2.0
"""Longest step of Gauss-Newton, in steps of finite differences."""
CLOSE = 0.03
"""A step of so many steps of finite differences (.02 pixels) needs no other."""
LOST = 0.5
"""After a last step of more than so many (.35 pixels) a pose is looked for from farther away."""
NEARBY = 1.5
"""And from where so many steps (1 pixel) have led elsewhere: differences are not linear over as far."""
FINE = 0.3
"""Share of a step of finite differences (.2 pixels) for the last steps: shorter than the width of an edge."""
AGAIN = 3
"""Times that the last steps are taken again, at most, until they lead no farther than one difference."""
ROUNDS = 4
"""Steps with one Jacobian, at most."""
TRUSTED = 0.5
"""Share of a frame's motion that its pose must explain; of others, positions are missing."""
UNCERTAIN = 0.25
"""Pixels; where a link is hidden, leaves the image or points at the camera, its joint is not known better, and
positions are missing, too."""
IN_VIEW = 0.5
"""Share of a link's length; with less inside the image, its angle is told far worse than by other frames."""
MOVED = 5.0
"""Robust standard deviations of noise by which a softened pixel differs where something has moved."""
SATURATED = 50.0
"""Grey levels; a pixel that is off by more is elsewhere altogether, and counts as if by so many."""


@dataclass(frozen=True)
class Pose:
    """Where a mechanism is in one frame.

    Attributes:
        q: `[nq]` joint positions, rad or m.
        covariance: `[nq, nq]` from the curvature of the fit and the size of residuals, as if pixels were independent.
        misfit: robust standard deviation of the residuals where something moves, grey levels.
        left: sum of the squares of grey levels that its drawing leaves of the frame.
        explained: share of what differs from the scene without this motion that the pose explains, 1 at best.
        uncertainty: standard deviation of the joint that the frame shows worst, as its links move in the image, pixels;
            by those pixels alone that change in proportion to it, which the stub of a link at the border has none of.
        in_view: share of a link's length that is inside the image, of the link that is least so.
        empty: nothing in the frame differs from what does not move.
    """

    q: Array
    covariance: Array
    misfit: float
    left: float
    explained: float
    uncertainty: float
    in_view: float
    empty: bool = False

    @property
    def out_of_view(self) -> bool:
        """Whether the mechanism has left the image, or most of a link has."""
        return self.empty or (self.explained >= TRUSTED and self.in_view < IN_VIEW)

    @property
    def readable(self) -> bool:
        """Whether the frame tells positions."""
        return self.explained >= TRUSTED and self.uncertainty <= UNCERTAIN and self.in_view >= IN_VIEW


def align(
    scene: Scene, look: Array, light: Light, frame: Image, still: Image, start: Array, near: bool, finely: bool = True
) -> Pose:
    """Fit joint positions to a frame.

    Args:
        scene: that draws.
        look: `[p]` of the scene.
        light: of the recording.
        frame: `[H, W, 3]`, 0 to 255.
        still: what the recording shows where nothing moves, see `explained_share`.
        start: `[nq]` positions to begin from.
        near: these are within a pixel, probably; if that turns out to be wrong, or if they are not, softened images
            come first.
        finely: take the last steps in any case; a pose near its start is up to twice as far off without them.
    """
    fit = _Fit(scene, look, light, frame)
    astray = not near or fit.converge(start, 0.0) >= LOST or fit.moved(start) >= NEARBY
    if astray:
        q = start
        for soft in SOFT:
            fit.converge(q, soft)
            q = fit.q
        fit.converge(q, 0.0)
    if not (finely or astray):
        return fit.pose(still)
    for _ in range(AGAIN):
        q = fit.q
        fit.converge(q, 0.0, FINE)
        if fit.moved(q) < FINE:
            break
        fit.converge(fit.q, 0.0)
    else:
        fit.converge(fit.q, 0.0, FINE)
    return fit.pose(still)


def align_again(scene: Scene, look: Array, light: Light, frame: Image, still: Image, start: Array, pose: Pose) -> Pose:
    """A pose by the last steps from elsewhere nearby, if it leaves less of the frame, or the same pose.

    Edges are drawn in a few shades, so that what a drawing leaves has many small minima, and steps end in the nearest.

    Args:
        scene: that draws.
        look: `[p]` of the scene.
        light: of the recording.
        frame: `[H, W, 3]`, 0 to 255.
        still: what the recording shows where nothing moves.
        start: `[nq]` positions to begin from.
        pose: the best so far.
    """
    fit = _Fit(scene, look, light, frame)
    fit.converge(start, 0.0, FINE)
    new = fit.pose(still)
    if new.left < pose.left:
        return new
    away = np.abs((start - pose.q) / scene.joint_steps(pose.q, look)).max()
    if away >= NEARBY or not np.isfinite(new.left):  # what the drawing there tells is not the pose's
        return pose
    return replace(pose, covariance=new.covariance, uncertainty=new.uncertainty)


class _Fit:
    """One frame, and the best pose so far."""

    def __init__(self, scene: Scene, look: Array, light: Light, frame: Image) -> None:
        """Nothing is tried yet."""
        self._scene, self._look, self._light, self._frame = scene, look, light, frame
        self._cost = np.inf
        self.q: Array = np.zeros(scene.model.nq)
        self._drawn, self._covariance = frame, np.zeros((len(self.q), len(self.q)))
        self._misfit = self._uncertainty = np.inf

    def pose(self, still: Image) -> Pose:
        """The best one."""
        share = explained_share(self._frame, self._drawn, still)
        in_view = self._scene.in_view(self.q, self._look)
        return Pose(self.q, self._covariance, self._misfit, self._cost, share, self._uncertainty, in_view)

    def moved(self, start: Array) -> float:
        """How far the best pose is from one that was begun from, in steps of finite differences."""
        away = (self.q - start) / self._scene.joint_steps(start, self._look)
        return float(np.abs(away).max())

    def converge(self, q: Array, soft: float, fine: float = 1.0) -> float:
        """Steps of Gauss-Newton with one Jacobian, on images softened so far; returns the length of the last.

        The Jacobian is of differences that are shorter by a factor `fine`.
        """
        frame, self._cost = softened(self._frame, soft), np.inf
        share = fine * (1 + soft)
        steps = share * self._scene.joint_steps(q, self._look)
        there = self._scene.render(q, self._look, soft)
        slopes = self._scene.jacobian(q, self._look, steps, there, soft)
        jacobian = slopes.first * (self._light.gain * steps[:, None, None, None])
        jacobian = jacobian.reshape(len(q), -1).T.astype(np.float64)
        size = np.abs(jacobian).max(axis=1)
        active = size > ACTIVE * max(float(size.max()), 1e-6)
        if not active.any():  # nothing that moves is in the image
            self.q = q
            return np.inf
        jacobian, bend = jacobian[active], (slopes.bend * self._light.gain).ravel().astype(np.float64)[active]
        length = np.inf
        for k in range(ROUNDS):
            drawn = self._light.apply(there if k == 0 else self._scene.render(q, self._look, soft))
            difference = (frame - drawn).ravel()
            left = difference[active].astype(np.float64)
            scale = max(FINEST, 1.4826 * float(np.median(np.abs(left))))
            weight = robust_weights(left, scale)
            normal = _information(jacobian, weight)
            cost = float(np.sum(np.minimum(np.abs(difference), SATURATED) ** 2))
            if cost < self._cost:
                self._cost, self.q, self._drawn, self._misfit = cost, q, drawn, scale
                self._covariance = scale**2 * np.linalg.inv(normal) * np.outer(steps, steps)
                straight = _information(jacobian, weight / (1 + (bend / scale) ** 2))
                self._uncertainty = STEP * share * scale * float(np.sqrt(np.linalg.inv(straight).diagonal().max()))
            step = np.linalg.solve(normal, jacobian.T @ (weight * left))
            length = float(np.abs(step).max())
            step *= min(1.0, FAR / max(length, 1e-9))
            if length < CLOSE:
                if cost == self._cost:
                    self.q = q + steps * step  # too short to be worth another look
                break
            q = q + steps * step
        return length


def _information(jacobian: Array, weight: Array) -> Array:
    """Normal matrix `[nq, nq]` of weighed pixels, with so little beside it that it can be inverted."""
    normal = jacobian.T @ (weight[:, None] * jacobian)
    return normal + (1e-6 * np.trace(normal) + 1e-9) * np.eye(len(normal))


def robust_weights(left: Array, scale: float) -> Array:
    """Of residuals with a robust standard deviation, after Huber."""
    return np.minimum(1.0, max(OUTLIER * scale, EDGE) / np.maximum(np.abs(left), 1e-9))


def nothing_moves(frame: Image, still: Image) -> bool:
    """Whether a frame shows what the recording shows where nothing moves, softened by a pixel, but for noise."""
    difference = np.abs(softened(frame - still, 1.0))
    noise = min(max(FINEST, 1.4826 * float(np.median(difference))), 2 * FINEST)
    return bool(difference.max() <= MOVED * noise)


def explained_share(frame: Image, drawn: Image, still: Image) -> float:
    """Share of the squared difference to a still image that a drawing explains, where either differs from it.

    All are softened by a pixel, so that the noise of pixels counts little.
    """
    frame, drawn, still = (softened(image, 1.0) for image in (frame, drawn, still))
    moved = np.maximum(np.abs(frame - still), np.abs(drawn - still)).max(axis=-1) > MOVED * FINEST
    if not moved.any():
        return 0.0
    left = np.minimum(np.abs(frame - drawn)[moved], SATURATED)
    there = np.minimum(np.abs(frame - still)[moved], SATURATED)
    return float(1 - np.sum(left**2) / max(np.sum(there**2), 1e-9))
