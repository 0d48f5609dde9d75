"""The error of positions that were read off frames: frames are drawn at known positions and read again."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from keycld_model.autocorrelation import samples_together
from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.follow import follow, turning
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.pose import Pose
from keycld_model.image_alignment.scene import STEP, Scene
from keycld_model.turns import nearest_turn

Array = NDArray[np.float64]
EXACT = 0.2
"""Share of the usual error that any frame has at least."""
OF_A_CAMERA = 1.2
"""Variance of errors in a camera's frames over that in frames that are drawn: these can be drawn exactly, with the look
that drew them, so that what a drawing leaves has a deeper minimum at the right position."""
READ_AGAIN = 40
"""Frames of a recording that are read again."""
ASTRAY = 1.0
"""Pixels; a position that is read so far from where it was drawn is that of something else."""
MOST_ASTRAY = 0.1
"""Share of the frames drawn at known positions that may be read astray."""
APART = 1.5
"""Pixels; what a frame shows beside its drawing is of another edge where the mechanism is so far away, at least. Two
frames are on either side of a third whose positions are less than half as far from their mean."""
NEAREST = 60
"""Frames among which two are looked for: their pairs are the square of it, and those farther away show other edges."""


class ReadAgain(NamedTuple):
    """What reading frames again that were drawn at known positions gave.

    Attributes:
        error: `[T, nq]` rad or m, as large as a camera's frames would have it, but for whole turns, which nobody counts
            while a link is out of view.
        unexplained: `[T]` share of what moves that the drawing at the position that was read does not explain. Frames
            that are read again have what two frames leave, so that these are scaled to what one leaves on average.
        fit_variance: `[T, nq]` variance by the curvature of the fit, (rad or m)^2, scaled likewise.
        pixels: `[T]` how far what is seen is off, by the worst joint.
    """

    error: Array
    unexplained: Array
    fit_variance: Array
    pixels: Array


def reading_error(
    scene: Scene,
    look: Array,
    light: Light,
    times: Array,
    frames: NDArray[np.uint8],
    poses: Sequence[Pose],
    bank: Bank,
    since: float,
) -> ReadAgain:
    """Errors in consecutive readable frames of a recording (a bootstrap of residuals).

    The positions that were read are drawn with the look and the light that were fitted, get what other frames show
    beside their own drawings, and are read again. These have the nearest positions, but for those that are nearer than
    a pixel: noise, compression, and what pixels do to edges are then as they are here. Two of them, on either side,
    are added and divided by the square root of two: noise is then as large as of one, but what is left along the edges
    of one, as by compression, would draw the pose towards it.

    Args:
        scene: that draws.
        look: `[p]` of the scene.
        light: of the recording.
        times: `[T]` of its frames, s.
        frames: `[T, H, W, 3]`.
        poses: that were read off them.
        bank: drawings of the scene.
        since: where these frames are in the recording, 0 if they are its first ones, 1 if its last.
    """
    none = np.zeros((0, scene.model.nq))
    nothing = ReadAgain(none, np.zeros(0), none, np.zeros(0))
    known = [k for k, pose in enumerate(poses) if pose.readable]
    if not known:
        return nothing
    first = round(since * max(0, len(known) - READ_AGAIN))
    frames, part = frames[known], slice(first, first + READ_AGAIN)
    drawn = np.stack([light.apply(scene.render(poses[k].q, look)) for k in known])
    q = np.array([poses[k].q for k in known])
    steps = np.array([scene.joint_steps(at, look) for at in q[part]])
    beside = [_beside(q, first + k, own) for k, own in enumerate(steps)]
    shown = drawn[part] + np.stack([(frames[k] - drawn[k]).sum(axis=0) / np.sqrt(len(k)) for k in beside])
    again = follow(scene, look, light, times[known][part], np.clip(np.round(shown), 0, 255).astype(np.uint8), bank)
    error = nearest_turn(np.array([pose.q for pose in again]), q[part], turning(scene.model)) - q[part]
    error -= np.median(error, axis=0)
    pixels = STEP * np.abs(error / steps).max(axis=1)
    good, kept = [pose.readable for pose in again], [pose for pose in again if pose.readable]
    if len(kept) < 2:  # the error of a single one is not told apart from the bias
        return nothing
    before = [poses[k] for k in known[part]]
    unexplained, fit_variance = (_as_of(of(before), of(kept)) for of in (unexplained_by, fit_variance_of))
    return ReadAgain(np.sqrt(OF_A_CAMERA) * error[good], unexplained, fit_variance, pixels[good])


def _as_of(first: Array, again: Array) -> Array:
    """What frames that were read again have, `[T]` or `[T, nq]`, with the mean of what they had at first."""
    return again * first.mean(axis=0) / np.maximum(again.mean(axis=0), 1e-30)


def unexplained_by(poses: Sequence[Pose]) -> Array:
    """Share of what moves that each pose does not explain, `[T]`."""
    return np.array([1 - pose.explained for pose in poses])


def fit_variance_of(poses: Sequence[Pose]) -> Array:
    """Variance of each joint by the curvature of each fit, `[T, nq]` (rad or m)^2."""
    return np.array([pose.covariance.diagonal() for pose in poses])


class ErrorModel(NamedTuple):
    """Variance of the error of a position: the more of a frame its drawing leaves unexplained, the larger.

    Edges are drawn in a few shades, so that a drawing fits a frame exactly or not at all. Where shades do not change,
    as of an upright pole between two of them, the fit has little curvature; that counts, too.

    Attributes:
        usual: `[nq]` mean, (rad or m)^2; NaN if there are no errors to tell it from.
        level: `[nq]` of a frame that is explained altogether.
        slope: `[nq]` per unexplained share.
        factor: `[nq]` of the variance by the curvature of the fit.
    """

    usual: Array
    level: Array
    slope: Array
    factor: Array

    @classmethod
    def of(cls, again: Sequence[ReadAgain]) -> "ErrorModel":
        """The likeliest one of errors that are normal."""
        errors, unexplained, fit_variance, _ = (np.concatenate(part) for part in zip(*again, strict=True))
        if not len(errors):
            unknown = np.full(errors.shape[1], np.nan)
            return cls(unknown, unknown, unknown, unknown)
        usual = np.mean(errors**2, axis=0)
        columns = (
            np.stack([np.ones(len(unexplained)), unexplained, own / own.mean()], axis=1) for own in fit_variance.T
        )
        found = np.array([_likeliest(c, e**2, u) for c, e, u in zip(columns, errors.T, usual, strict=True)])
        return cls(usual, found[:, 0], found[:, 1], found[:, 2] / fit_variance.mean(axis=0))

    def deviation(self, unexplained: Array, fit_variance: Array) -> Array:
        """Standard deviations `[T, nq]` of frames with unexplained shares `[T]` and variances by the fit `[T, nq]`."""
        variance = self.level + self.slope * unexplained[:, None] + self.factor * fit_variance
        return np.sqrt(np.maximum(EXACT**2 * self.usual, variance))


def _likeliest(columns: Array, squares: Array, usual: float) -> Array:
    """Coefficients, not negative, of variances that are linear in columns `[N, k]`, of squared errors `[N]`."""
    variance = np.full(len(squares), max(float(usual), 1e-30))
    out = np.zeros(columns.shape[1])
    for _ in range(20):
        out, _ = nnls(columns / variance[:, None], squares / variance)
        variance = np.maximum(columns @ out, EXACT**2 * usual)
    return out


def read_astray(again: Sequence[ReadAgain]) -> float:
    """Share of what is drawn at known positions that is read elsewhere; of nothing, none."""
    pixels = np.concatenate([part.pixels for part in again])
    return float(np.mean(pixels >= ASTRAY)) if len(pixels) else 0.0


def frames_together(errors: Sequence[Array]) -> Array:
    """Number of frames `[nq]` over which errors `[T, nq]` of recordings are correlated; see `samples_together`."""
    own = [e - e.mean(axis=0) for e in errors if len(e) > 1]
    if not own:
        return np.ones(errors[0].shape[1])
    return samples_together(
        lambda lag: np.sum([np.mean(e[lag:] * e[: len(e) - lag], axis=0) for e in own], axis=0),
        min(len(e) for e in own) // 2,
    )


def _beside(q: Array, k: int, steps: Array) -> NDArray[np.intp]:
    """Indices of two frames with positions on either side of those of frame k, near, but far enough.

    Of one, where no two are; of the farthest, if none is far enough.

    Args:
        q: `[T, nq]` positions.
        k: index of the frame.
        steps: `[nq]` changes of each joint that move what is seen by `STEP` pixels.
    """
    away = STEP * (q - q[k]) / steps
    distance = np.abs(away).max(axis=1)
    nearest = np.argsort(distance, kind="stable")
    enough = nearest[distance[nearest] >= APART][:NEAREST]
    if not len(enough):
        return nearest[-1:]
    together = np.abs(away[enough][:, None] + away[enough]).max(axis=-1)
    first, second = np.unravel_index(
        np.argmin(together + (distance[enough][:, None] + distance[enough]) / 2), together.shape
    )
    return enough[[first, second]] if together[first, second] < APART else enough[:1]
