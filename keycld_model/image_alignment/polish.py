"""The end of a look's fit to compressed frames, without derivatives.

What compression leaves goes with the edges of what is drawn, and so with slopes of drawings, which are of finite
differences: the look at which least squares along such slopes come to rest has not the least squares. And it takes
fine detail from what stands still and is faint, so that blur is more there than where the mechanism is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import FINE, SATURATED
from keycld_model.image_alignment.scene import STEP, Scene
from keycld_model.image_alignment.simplex import least_near

Array = NDArray[np.float64]
Image = NDArray[np.float32]
REACH = (0.3, -0.15)
"""Pixels of the first steps of simplex searches, one after the other."""
EXACT = 0.01
"""Pixels that what is seen moves by in the last steps."""
EVALUATIONS = 60
"""Of such a search, at most; each draws every frame three times."""
FOLLOWING = 2
"""Steps by which a pose follows a look."""
MOST_BLUR = 1.0
"""Square pixels, as of a camera out of focus; variances are searched up to this one, or up to twice the one so far."""
EXACT_BLUR = 0.005
"""Square pixels; a fiftieth of what compression was taken for."""


@dataclass(frozen=True)
class Follower:
    """A frame whose pose follows when the look changes.

    Attributes:
        frame: `[H, W, 3]`.
        light: of its recording.
        q: `[nq]` pose with the look so far.
        ahead: `[nq, k]` change of the pose with the look, in `k` directions.
        back: `[nq, pixels]` change of the pose with what is left of the frame.
    """

    frame: Image
    light: Light
    q: Array
    ahead: Array
    back: Array

    @classmethod
    def of(cls, scene: Scene, look: Array, directions: Array, frame: Image, light: Light, q: Array) -> Self:
        """About a look `[p]` and a pose, in directions `[k, p]`."""
        steps = FINE * scene.joint_steps(q, look)
        there = scene.render(q, look)
        slopes = scene.jacobian(q, look, steps, there).first * light.gain
        back = np.asarray(np.linalg.pinv(slopes.reshape(len(q), -1).T.astype(np.float64)), np.float64)
        changes = [(scene.render(q, look + d) - scene.render(q, look - d)) / 2 * light.gain for d in directions]
        return cls(frame, light, q, -back @ np.stack([change.ravel() for change in changes], axis=1), back)

    def left(self, scene: Scene, look: Array, z: Array) -> float:
        """Squares of grey levels that a drawing leaves where the look was moved by `[k]` directions."""
        q, least = self.q + self.ahead @ z, np.inf
        for step in range(FOLLOWING + 1):
            left = np.clip(self.frame - self.light.apply(scene.render(q, look)), -SATURATED, SATURATED)
            least = min(least, float(np.sum(left**2)))
            if step < FOLLOWING:
                q = q + self.back @ left.ravel()
        return least


def best_blur(scene: Scene, look: Array, frames: Sequence[tuple[Image, Light, Array]]) -> float:
    """The variance of blur, square pixels, with which drawings leave the least squares of frames; as in `polished`."""

    def left(variance: float) -> float:
        blurred = np.append(look[:-1], variance)
        drawn = [light.apply(scene.render(q, blurred)) for _, light, q in frames]
        off = [frame - own for (frame, _, _), own in zip(frames, drawn, strict=True)]
        return float(np.sum(np.clip(off, -SATURATED, SATURATED) ** 2))

    most = max(MOST_BLUR, 2 * float(look[-1]))
    found: Any = minimize_scalar(left, bounds=(0.0, most), method="bounded", options={"xatol": EXACT_BLUR})
    return min(float(look[-1]), float(found.x), key=left)


def polished(
    scene: Scene, look: Array, directions: Array, frames: Sequence[tuple[Image, Light, Array]]
) -> tuple[Array, float]:
    """The look `[p]` nearby with the least squares, and these squares of grey levels.

    Args:
        scene: that draws.
        look: `[p]` to begin from.
        directions: `[k, p]` in which it may move, each by about `STEP` pixels of what is seen.
        frames: with the light of their recordings and the poses in that look.
    """
    followers = [Follower.of(scene, look, directions, *frame) for frame in frames]

    def left(z: Array) -> float:
        there = look + z @ directions
        return sum(follower.left(scene, there, z) for follower in followers)

    reaches = [reach / STEP for reach in REACH]
    best, least = least_near(left, len(directions), reaches, EVALUATIONS, EXACT / STEP)
    return look + best @ directions, least
