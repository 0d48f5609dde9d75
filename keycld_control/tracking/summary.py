"""The numbers of a track, for the terminal, track.json and the page."""

import math
from typing import Any

import numpy as np

from keycld_model.tracking import Track
from keycld_model.tracking.pendulum import Study

GRAVITY = 9.81
TURNED = math.pi / 4
"""Angle of rest, rad, that no camera held by hand makes."""
ASKEW = 0.04
"""rad, root mean square, by which a part may turn otherwise than its keypoint does about the pivot. Tracks that are
right have .0007 to .023; one of a pendulum whose bob was covered had .078, and angles .6 rad off."""
MOST, ROUND, VAGUE, INFLATED, UNEXPLAINED = 0.8, 0.01, 0.03, 30.0, 10.0
"""What raises a doubt: share of frames, lengths off the circle, lengths of the pivot's deviation, inflation of
covariances, and held-out error in noises of a frame."""


def summary(track: Track, study: Study | None) -> dict[str, Any]:
    """Names and values; pixels are those of the video.

    Args:
        track: what was followed.
        study: of a free pendulum, None for others.
    """
    result: dict[str, Any] = {
        "frames": len(track.film),
        "seconds": float(track.film.times[-1]),
        "clock": track.film.clock,
        "width": track.film.size[0],
        "height": track.film.size[1],
        "missing": (~track.found).sum(axis=0),
        "trusted": track.trusted.mean(axis=0),
        "repeated_frames": track.repeated,
        "camera_travel_px": track.camera_travel,
        "pivot_px": np.median(track.pivot, axis=0),
        "pivot_std_px": track.pivot_deviation,
        "pivot_in_view": bool(_inside(track)),
        "length_px": track.lengths,
        "length_std_px": track.length_deviation,
        "stretched": np.nanquantile(np.abs(track.stretched), 0.95, axis=0),
        "axis_ratio": track.tilt,
        "circle_pivot_px": track.circle_pivot,
        "rods_seen": track.rods_seen,
        "noise_px": track.noise,
        "angle_noise_mrad": 1e3 * track.angle_noise,
        "covariance_inflation": track.inflation,
        "off_circle_px": track.off_circle,
        "turning_mrad": 1e3 * track.turning,
        "amplitude_rad": np.ptp(np.nanquantile(track.angles, (0.01, 0.99), axis=0), axis=0) / 2,
    }
    result["doubts"] = doubts(track, study)
    if track.mechanism.num_actions:
        result["dissipation"] = "It cannot be determined without the torque of the motor."
        return result
    if track.mechanism.num_keypoints > 1:
        result["dissipation"] = "It is determined for one rod only, not for chains."
        return result
    if study is None:
        result["dissipation"] = (
            "It cannot be determined: the motion is no free swing of a pendulum over at least three and a half periods "
            "(if it is one, the track is wrong, see overlay.mp4, or frames are missing from the video)."
        )
        return result
    return result | _of_study(track, study)


def doubts(track: Track, study: Study | None) -> list[str]:
    """What speaks against a track, in sentences; nothing if nothing does."""
    result = []
    for k, length in enumerate(track.lengths):
        part, keypoint = ("The part", "The keypoint") if len(track.lengths) == 1 else (f"Link {k}", f"Keypoint {k}")
        found, trusted = track.found[:, k].mean(), track.trusted[:, k].mean()
        if found < MOST:
            result.append(f"{part} was found in only {100 * found:.0f} % of the frames.")
        if trusted < MOST * found:
            longest = 100 * np.nanquantile(np.abs(track.stretched[:, : k + 1]), 0.95)
            result.append(
                f"{part} can be trusted in only {100 * trusted:.0f} % of the frames: elsewhere a length is up to "
                f"{longest:.0f} % off, because the motion leaves the picture's plane, or the track is wrong."
            )
        if track.off_circle[k] > ROUND * length:
            result.append(f"{keypoint} is {track.off_circle[k]:.1f} px off its circle: pivot and angles may be wrong.")
        if track.inflation[k] > INFLATED:
            result.append(
                f"{part} scatters far more than its fit lets expect: it may have been lost at times, or frames are "
                "missing."
            )
    if len(track.lengths) == 1 and track.turning[0] > ASKEW:
        result.append(
            f"The part turns otherwise than about the pivot, by {1e3 * track.turning[0]:.0f} mrad: pivot and angles "
            "may be wrong; a part of the mechanism may be covered."
        )
    if float(np.hypot(*track.pivot_deviation)) > VAGUE * track.lengths[0]:
        result.append(f"The pivot is known to {np.hypot(*track.pivot_deviation):.0f} px only.")
    if study is not None and abs(study.rest) > TURNED:
        result.append(
            f"The pendulum rests at {math.degrees(study.rest):.0f}° from the picture's downward direction: the video "
            "is turned."
        )
    if study is not None and study.candidates[0].held_out > UNEXPLAINED * track.angle_noise[0]:
        result.append(
            f"No dissipation predicts to within noise: {1e3 * study.candidates[0].held_out:.1f} mrad are off where one "
            f"frame scatters by {1e3 * track.angle_noise[0]:.2f} mrad."
        )
    return result


def _of_study(track: Track, study: Study) -> dict[str, Any]:
    period, low, high = study.period
    return {
        "period_s": period,
        "period_90": [low, high],
        "length_m_if_point_mass": GRAVITY * (period / (2 * math.pi)) ** 2,
        "angle_of_rest_mrad": 1e3 * study.rest,
        "dissipation": study.words,
        "named": None if study.named is None else list(study.named),
        "parameters": {
            k: {"value": v, "low": lo, "high": hi, "unit": u} for k, (v, lo, hi, u) in study.parameters.items()
        },
        "candidates": [
            {
                "effects": list(c.terms),
                "held_out_mrad": 1e3 * c.held_out,
                "fitted_mrad": 1e3 * c.fitted,
                "excluded": c.excluded,
            }
            for c in study.candidates
        ],
        "prediction_from_s": study.split,
        "half_swings": len(study.swings),
    }


def _inside(track: Track) -> np.bool_:
    x, y = np.median(track.pivot, axis=0)
    return np.bool_(0 <= x <= track.film.size[0] - 1 and 0 <= y <= track.film.size[1] - 1)
