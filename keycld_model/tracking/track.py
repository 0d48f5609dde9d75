"""A video's mechanism followed from frame to frame: keypoints, pivot and angles, with their uncertainty."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism
from keycld_envs.progress import Advance
from keycld_model.tracking.camera import Camera, camera_motion, picture_area
from keycld_model.tracking.film import Film, read_film
from keycld_model.tracking.pivot import Pivot
from keycld_model.tracking.rod import find_rods, meeting_point
from keycld_model.tracking.scatter import scatter
from keycld_model.tracking.single import Part, follow
from keycld_model.tracking.tilt import Tilt, fit_tilt

Array = NDArray[np.float64]
SAME = 0.03
"""Radii by which the circle's centre and the meeting point of the rods may differ where the plane is parallel."""
FLATTEST = 0.6
"""Ratio of axes below which an ellipse is not believed."""


@dataclass(frozen=True, eq=False)
class Track:
    """Where the keypoints of a mechanism are in a video.

    Pixels are those of the video as it is shown, column to the right and row down; the centre of the first is 0.

    Attributes:
        film: the video.
        mechanism: that was followed.
        keypoints: [T, K, 2], pixels; NaN where a keypoint was not found.
        covariance: [T, K, 2, 2], pixels².
        pivot: [T, 2], pixels; it moves in the frames as far as the camera does.
        angles: [T, K], rad: of the first rod, counter-clockwise from the picture's downward direction; unwrapped.
        deviation: [T, K], rad, standard deviations of `angles`.
        lengths: [K], pixels, of the rods in the picture, at the middle of the motion.
        length_deviation: [K], pixels.
        pivot_deviation: [2], pixels.
        noise: [K, 2], pixels: scatter of column and row about smooth motion.
        angle_noise: [K], rad.
        inflation: by which the covariances of the fit were multiplied to match that scatter.
        turning: rad, by which the part turns otherwise than its rod.
        off_circle: pixels, root mean square distance of the keypoint from its circle.
        camera_travel: pixels, the largest way of a corner of the picture; 0 for a camera at rest.
        tilt: shorter over longer axis of the ellipse on which the keypoint moves, where the plane of motion is not
            parallel to the picture; 1 where it is, or no rod is seen that could tell.
        spokes: [2, 2], pixels: of the direction (sin, cos) of an angle, the way from the pivot to the keypoint.
        circle_pivot: [2], pixels, the pivot if the motion were a circle in the picture.
        rods_seen: frames in which the direction of the rod was measured.
        repeated: number of frames that copy the one before during motion, which count as missing.
    """

    film: Film
    mechanism: Mechanism
    keypoints: Array
    covariance: Array
    pivot: Array
    angles: Array
    deviation: Array
    lengths: Array
    length_deviation: Array
    pivot_deviation: Array
    noise: Array
    angle_noise: Array
    inflation: float
    turning: float
    off_circle: float
    camera_travel: float
    tilt: float
    spokes: Array
    circle_pivot: Array
    rods_seen: int
    repeated: int

    def pixel(self, t: int, angle: float) -> Array:
        """Where the keypoint would be in frame t at an angle, rad; [2], pixels."""
        return self.pivot[t] + self.spokes @ np.array([np.sin(angle), np.cos(angle)])

    @property
    def found(self) -> NDArray[np.bool_]:
        """[T, K], whether each keypoint was found."""
        return np.isfinite(self.keypoints[..., 0])


def steps(film: Film) -> int:
    """Steps of the progress bar of `track`."""
    return 6 * len(film)


def read(path: Path, mechanism: Mechanism, fps: float | None = None) -> Film:
    """Read a video for a mechanism that can be followed.

    Raises:
        InputError: as `keycld_model.tracking.film.read_film`, and for a mechanism that cannot.
    """
    if (
        mechanism.sliders
        or len(mechanism.rods) != 1
        or mechanism.num_keypoints != 1
        or mechanism.rods[0].start is not None
    ):
        raise InputError(
            "--mechanism: only one keypoint on one rod from the pivot can be followed in a video so far; declare "
            "Mechanism(num_keypoints=1, num_actions=0, rods=(Rod(None, 0),))."
        )
    return read_film(path, fps)


def track(film: Film, mechanism: Mechanism, seed: int, advance: Advance) -> Track:
    """Follow a mechanism through a video.

    Args:
        film: the video, by `read`.
        mechanism: one rod from the pivot to a keypoint.
        seed: of the random search for what turns about a pivot.
        advance: a progress bar of `steps(film)` steps.

    Raises:
        InputError: if nothing in the video moves as the mechanism can.
    """
    area = picture_area(film.pixels)
    camera = camera_motion(film.pixels, area, advance)
    part, circle = follow(film, camera, area, seed, advance)
    places, covariance = part.places(part.keypoint)
    copies = _copies(film, places)
    missing = ~part.seen | copies
    places = np.where(missing[:, None], np.nan, places)
    rods = find_rods(film, camera, area, places, circle.centre, part.thickness)
    pivot, tilt = _tilted(places, circle, meeting_point(places, rods))
    found = _Found(part, circle, pivot, tilt, len(rods.frames), copies)
    return _assemble(film, mechanism, camera, found, places, np.where(missing[:, None, None], np.nan, covariance))


@dataclass(frozen=True, eq=False)
class _Found:
    part: Part
    circle: Pivot
    pivot: Pivot
    tilt: Tilt | None
    rods_seen: int
    copies: NDArray[np.bool_]


def _tilted(places: Array, circle: Pivot, meeting: tuple[Array, Array, float] | None) -> tuple[Pivot, Tilt | None]:
    """The pivot where all rods meet, and the ellipse about it, where that is plainly no circle; else the circle."""
    if meeting is None:
        return circle, None
    centre, deviation, _ = meeting
    apart = np.linalg.norm(centre - circle.centre)
    if apart < max(SAME * circle.radius, 4 * float(np.hypot(*deviation))):
        return circle, None
    seen = places[np.isfinite(places[:, 0])]
    tilt = fit_tilt(seen, centre)
    if tilt is None or tilt.ratio < FLATTEST:
        return circle, None
    away = seen - centre
    angles = np.unwrap(np.arctan2(away[:, 0], away[:, 1]))
    aside = np.abs(angles - np.quantile(angles, (0.05, 0.95)).mean())
    radius = float(np.median(np.linalg.norm(away, axis=1)[aside <= np.quantile(aside, 0.15)]))
    along = float(np.hypot(*deviation))
    return Pivot(centre, radius, np.array([*deviation, along]), circle.turning, tilt.off), tilt


def _assemble(
    film: Film, mechanism: Mechanism, camera: Camera, found: _Found, places: Array, covariance: Array
) -> Track:
    """Everything in pixels of the video, calibrated."""
    pivot = found.pivot
    stretch = np.eye(2) if found.tilt is None else found.tilt.stretch
    radius = pivot.radius if found.tilt is None else found.tilt.radius
    spokes = float(radius) * np.asarray(np.linalg.inv(stretch), float)
    noise = np.array([scatter(film.times, column)[1] for column in places.T])
    expected = np.nanmedian(np.einsum("tii->ti", covariance), axis=0)
    measured = np.nan_to_num(noise) ** 2
    inflation = max(1e-3, float((measured / expected).mean())) if measured.any() else 1.0
    covariance = covariance * inflation
    away = (places - pivot.centre) @ stretch.T
    distance = np.linalg.norm(away, axis=1)
    tangent = np.stack([-away[:, 1], away[:, 0]], axis=1) @ stretch / distance[:, None]
    deviation = np.sqrt(np.einsum("ti,tij,tj->t", tangent, covariance, tangent)) / distance
    angles = _unwrapped(np.arctan2(away[:, 0], away[:, 1]), film.times)
    centres = np.array([camera.to_frame(t, pivot.centre) for t in range(len(film))])
    in_frames = np.array([camera.to_frame(t, p) for t, p in enumerate(places)])
    covariance = np.einsum("tij,tjk,tlk->til", camera.linear, covariance, camera.linear)
    s = film.scale
    return Track(
        film=film,
        mechanism=mechanism,
        keypoints=film.to_video(in_frames)[:, None],
        covariance=s**2 * covariance[:, None],
        pivot=film.to_video(centres),
        angles=angles[:, None],
        deviation=deviation[:, None],
        lengths=s * np.array([pivot.radius]),
        length_deviation=s * pivot.deviation[2:],
        pivot_deviation=s * pivot.deviation[:2],
        noise=s * noise[None],
        angle_noise=np.array([scatter(film.times, angles)[1]]),
        inflation=inflation,
        turning=pivot.turning,
        off_circle=s * pivot.off,
        camera_travel=s * float(camera.travel.max()) if camera.moves else 0.0,
        tilt=1.0 if found.tilt is None else found.tilt.ratio,
        spokes=s * spokes,
        circle_pivot=film.to_video(found.circle.centre),
        rods_seen=found.rods_seen,
        repeated=int(found.copies.sum()),
    )


def _unwrapped(angles: Array, times: Array) -> Array:
    """Angles without jumps of whole turns: from frame to frame by less than half a turn, across gaps by their speed."""
    result = angles.copy()
    known = np.flatnonzero(np.isfinite(angles))
    for n, i in enumerate(known[1:], 1):
        before = known[n - 1]
        expected = result[before]
        if i > before + 1 and n > 1 and known[n - 2] == before - 1:
            speed = (result[before] - result[before - 1]) / (times[before] - times[before - 1])
            expected += speed * (times[i] - times[before])
        result[i] = angles[i] + 2 * np.pi * np.round((expected - angles[i]) / (2 * np.pi))
    return result


def _copies(film: Film, places: Array) -> NDArray[np.bool_]:
    """Frames that copy the one before while the part moves: their picture is older than their time."""
    before = np.linalg.norm(np.roll(places, 1, axis=0) - np.roll(places, 2, axis=0), axis=1)
    after = np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)
    return film.repeated & ((before > 0.5) | (after > 0.5))
