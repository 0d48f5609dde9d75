"""A video's mechanism followed from frame to frame: keypoints, pivot and angles, with their uncertainty."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism, Rod
from keycld_envs.progress import Advance
from keycld_model.tracking.camera import Camera, camera_motion, picture_area
from keycld_model.tracking.chain import Part, follow
from keycld_model.tracking.film import Film, read_film
from keycld_model.tracking.pivot import Pivot
from keycld_model.tracking.rod import find_rods, meeting_point
from keycld_model.tracking.scatter import scatter
from keycld_model.tracking.starts import from_circle, from_points
from keycld_model.tracking.tilt import Tilt, fit_tilt

Array = NDArray[np.float64]
SAME = 0.03
"""Radii by which the circle's centre and the meeting point of the rods may differ where the plane is parallel."""
FLATTEST = 0.6
"""Ratio of axes below which an ellipse is not believed."""
LENGTHENED = 0.03
"""Share of its length by which a rod may differ from it in a frame: one that leaves the plane of motion by 14° does."""
FARTHEST = 20.0
"""Longer sides of the picture; about a pivot farther away, what is seen turns by less than .05 rad: it slides."""
MARKS_APART = 4.0
"""Pixels between the ends of a rod that are marked in a frame, at least."""


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
        angles: [T, K], rad, counter-clockwise and unwrapped: of the first rod from the picture's downward direction, of
            each other rod from the direction of the one before.
        deviation: [T, K], rad, standard deviations of `angles`.
        lengths: [K], pixels, of the rods in the picture, at the middle of the motion.
        length_deviation: [K], pixels.
        pivot_deviation: [2], pixels.
        stretched: [T, K], by what each rod is longer in a frame than its length, relative to it: 0 for motion in one
            plane that is followed rightly.
        noise: [K, 2], pixels: scatter of column and row about smooth motion.
        angle_noise: [K], rad.
        inflation: [K], by which the covariances of the fit were multiplied to match that scatter.
        turning: [K], rad, by which each part turns otherwise than its rod.
        off_circle: [K], pixels, root mean square distance of each keypoint from its circle about what it hangs on.
        camera_travel: pixels, the largest way of a corner of the picture; 0 for a camera at rest.
        tilt: shorter over longer axis of the ellipse on which the first keypoint moves, where the plane of motion is
            not parallel to the picture; 1 where it is, for chains, or if no rod is seen that could tell.
        spokes: [2, 2], pixels: of the direction (sin, cos) of an angle, the way from the pivot to the first keypoint.
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
    stretched: Array
    noise: Array
    angle_noise: Array
    inflation: Array
    turning: Array
    off_circle: Array
    camera_travel: float
    tilt: float
    spokes: Array
    circle_pivot: Array
    rods_seen: int
    repeated: int

    def pixel(self, t: int, angle: float) -> Array:
        """Where the first keypoint would be in frame t at an angle, rad; [2], pixels."""
        return self.pivot[t] + self.spokes @ np.array([np.sin(angle), np.cos(angle)])

    @property
    def found(self) -> NDArray[np.bool_]:
        """[T, K], whether each keypoint was found."""
        return np.isfinite(self.keypoints[..., 0])

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """[T, K], whether each angle is known, and its rods have the lengths that they have in the plane of motion."""
        straight = np.abs(self.stretched) < LENGTHENED
        return straight & np.column_stack([np.ones(len(straight), bool), straight[:, :-1]])


def steps(film: Film, mechanism: Mechanism) -> int:
    """Steps of the progress bar of `track`."""
    return (4 + 2 * len(mechanism.rods)) * len(film)


def read(path: Path, mechanism: Mechanism, fps: float | None = None) -> Film:
    """Read a video for a mechanism that can be followed.

    Raises:
        InputError: as `keycld_model.tracking.film.read_film`, and for a mechanism that cannot.
    """
    count = mechanism.num_keypoints
    chain = [Rod(k - 1 if k else None, k) for k in range(count)]
    if mechanism.sliders or list(mechanism.rods) != chain:
        raise InputError(
            "--mechanism: only a chain can be followed in a video so far, a rod from the pivot to keypoint 0, then "
            f"from each keypoint to the next; declare Mechanism({count}, ..., rods=({', '.join(map(_words, chain))},))."
        )
    return read_film(path, fps)


def _words(rod: Rod) -> str:
    return f"Rod({rod.start}, {rod.end})"


def check_marks(film: Film, mechanism: Mechanism, marks: Array | None, frame: int) -> None:
    """Refuse marks that cannot be pivot and keypoints in a frame.

    Args:
        film: the video.
        mechanism: a chain of K rods.
        marks: [n, 2], pixels; None if nothing was marked.
        frame: the index.

    Raises:
        InputError: if there are too few or too many, or they are not in the picture.
    """
    count = mechanism.num_keypoints
    if marks is None:
        if count > 1:
            raise InputError(
                f"--marks: mark the pivot and {count} keypoints in one frame, as {count + 1} pairs of column and row "
                "in pixels; only one rod alone can be found without."
            )
        return
    if len(marks) != count + 1:
        raise InputError(f"--marks has {len(marks)} pairs; it needs {count + 1}: the pivot, then {count} keypoints.")
    if not 0 <= frame < len(film):
        raise InputError(f"--frame is {frame}; {film.path} has frames 0 to {len(film) - 1}.")
    if not ((marks[1:] >= 0) & (marks[1:] < film.size)).all():
        width, height = film.size
        raise InputError(f"--marks: a keypoint is outside the picture of {width} by {height} pixels.")
    if np.linalg.norm(np.diff(marks, axis=0), axis=1).min() < MARKS_APART:
        raise InputError(f"--marks: two ends of a rod are less than {MARKS_APART:.0f} pixels apart; mark both ends.")


def track(
    film: Film, mechanism: Mechanism, seed: int, advance: Advance, marks: Array | None = None, frame: int = 0
) -> Track:
    """Follow a mechanism through a video.

    Args:
        film: the video, by `read`.
        mechanism: a chain of K rods from the pivot.
        seed: of the random search for what turns about a pivot.
        advance: a progress bar of `steps(film, mechanism)` steps.
        marks: [K + 1, 2], pixels, pivot and keypoints in one frame; the pivot may be outside the picture. One rod needs
            none.
        frame: the index of that frame.

    Raises:
        InputError: if nothing in the video moves as the mechanism can, or as `check_marks`.
    """
    check_marks(film, mechanism, marks, frame)
    area = picture_area(film.pixels)
    camera = camera_motion(film.pixels, area, advance)
    if marks is None:
        start = from_circle(film, camera, area, seed, advance)
    else:
        start = from_points(film, camera, area, marks, frame, advance)
    parts, circles = follow(film, camera, area, start, advance)
    places = np.stack([part.places(part.keypoint)[0] for part in parts], axis=1)
    copies = _copies(film, places[:, -1])
    missing = ~np.stack([part.seen for part in parts], axis=1) | copies[:, None]
    places = np.where(missing[..., None], np.nan, places)
    found = _Found(parts, circles, circles[0], None, 0, copies)
    if not circles[0].radius < FARTHEST * max(film.pixels.shape[1:3]):
        raise InputError(
            f"What could be followed in {film.path} goes straight, and turns about no pivot that could be told; chains "
            "of rods can be followed if all of them is in view, slides cannot."
        )
    if len(parts) == 1:  # the links of a chain are thick, and lines along their edges do not meet at the pivot
        rods = find_rods(film, camera, area, places[:, 0], circles[0].centre, parts[0].thickness)
        pivot, tilt = _tilted(places[:, 0], circles[0], meeting_point(places[:, 0], rods))
        found = replace(found, pivot=pivot, tilt=tilt, rods_seen=len(rods.frames))
    return _assemble(film, mechanism, camera, found, places)


@dataclass(frozen=True, eq=False)
class _Found:
    parts: list[Part]
    circles: list[Pivot]
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


def _assemble(film: Film, mechanism: Mechanism, camera: Camera, found: _Found, places: Array) -> Track:
    """Everything in pixels of the video, calibrated."""
    pivot = found.pivot
    pivots = [pivot, *found.circles[1:]]
    stretch = np.eye(2) if found.tilt is None else found.tilt.stretch
    radius = pivot.radius if found.tilt is None else found.tilt.radius
    spokes = float(radius) * np.asarray(np.linalg.inv(stretch), float)
    noise = np.array([[scatter(film.times, column)[1] for column in place.T] for place in np.swapaxes(places, 0, 1)])
    covariance = np.stack([part.places(part.keypoint)[1] for part in found.parts], axis=1)
    covariance = np.where(np.isfinite(places)[..., None], covariance, np.nan)
    expected = np.nanmedian(np.einsum("tkii->tki", covariance), axis=0)
    inflation = np.array([_inflation(np.nan_to_num(n) ** 2, e) for n, e in zip(noise, expected, strict=True)])
    covariance = covariance * inflation[:, None, None]
    ends = np.concatenate([np.broadcast_to(pivot.centre, (len(places), 1, 2)), places], axis=1)
    away = np.diff(ends, axis=1) @ stretch.T
    distance = np.linalg.norm(away, axis=-1)
    directions = np.arctan2(away[..., 0], away[..., 1])
    angles = np.diff(directions, axis=1, prepend=0)
    angles = np.stack([_unwrapped(np.angle(np.exp(1j * angle)), film.times) for angle in angles.T], axis=1)
    tangent = np.stack([-away[..., 1], away[..., 0]], axis=-1) @ stretch / distance[..., None] ** 2
    usual = np.array([radius, *np.nanmedian(distance[:, 1:], axis=0)])
    centres = np.array([camera.to_frame(t, pivot.centre) for t in range(len(film))])
    in_frames = np.array([camera.to_frame(t, p) for t, p in enumerate(places)])
    carried = np.einsum("tij,tkjl,tml->tkim", camera.linear, covariance, camera.linear)
    s = film.scale
    return Track(
        film=film,
        mechanism=mechanism,
        keypoints=film.to_video(in_frames),
        covariance=s**2 * carried,
        pivot=film.to_video(centres),
        angles=angles,
        deviation=_deviation(tangent, covariance),
        lengths=s * np.array([each.radius for each in pivots]),
        length_deviation=s * np.array([each.deviation[2] for each in pivots]),
        pivot_deviation=s * pivot.deviation[:2],
        stretched=distance / usual - 1,
        noise=s * noise,
        angle_noise=np.array([scatter(film.times, angle)[1] for angle in angles.T]),
        inflation=inflation,
        turning=np.array([each.turning for each in pivots]),
        off_circle=s * np.array([each.off for each in pivots]),
        camera_travel=s * float(camera.travel.max()) if camera.moves else 0.0,
        tilt=1.0 if found.tilt is None else found.tilt.ratio,
        spokes=s * spokes,
        circle_pivot=film.to_video(found.circles[0].centre),
        rods_seen=found.rods_seen,
        repeated=int(found.copies.sum()),
    )


def _inflation(measured: Array, expected: Array) -> float:
    """What multiplies a covariance, given variances of column and row [2] as measured and as expected, pixels²."""
    return max(1e-3, float((measured / expected).mean())) if measured.any() else 1.0


def _deviation(tangent: Array, covariance: Array) -> Array:
    """Standard deviations of all angles, [T, K], rad.

    Args:
        tangent: [T, K, 2], rad per working pixel: what each rod turns by if its end moves, and minus that if its start
            does.
        covariance: [T, K, 2, 2], of the keypoints, working pixels².
    """
    count = tangent.shape[1]
    turns = np.zeros((len(tangent), count + 1, count + 1, 2))  # of rod, counted from 1, if an end moves, 0 the pivot
    for k in range(count):
        turns[:, k + 1, k + 1], turns[:, k + 1, k] = tangent[:, k], -tangent[:, k]
    by = np.diff(turns, axis=1)[:, :, 1:]
    held = np.asarray(by.any(axis=(0, -1)))
    covariance = np.where(held[..., None, None], covariance[:, None], 0)
    return np.sqrt(np.einsum("tjki,tjkil,tjkl->tj", by, covariance, by))


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
