"""The numbers of a track, for the terminal, track.json and the page."""

import math
from typing import Any

import numpy as np

from keycld_model.tracking import Track
from keycld_model.tracking.pendulum import Study

GRAVITY = 9.81


def summary(track: Track, study: Study | None, driven: bool) -> dict[str, Any]:
    """Names and values; pixels are those of the video.

    Args:
        track: what was followed.
        study: of a free pendulum, None for others.
        driven: whether the mechanism has motors.
    """
    found = track.found
    result: dict[str, Any] = {
        "frames": len(track.film),
        "seconds": float(track.film.times[-1]),
        "clock": track.film.clock,
        "width": track.film.size[0],
        "height": track.film.size[1],
        "missing": int((~found).sum()),
        "repeated_frames": track.repeated,
        "camera_travel_px": track.camera_travel,
        "pivot_px": np.median(track.pivot, axis=0),
        "pivot_std_px": track.pivot_deviation,
        "pivot_in_view": bool(_inside(track)),
        "length_px": track.lengths,
        "length_std_px": track.length_deviation,
        "axis_ratio": track.tilt,
        "circle_pivot_px": track.circle_pivot,
        "rods_seen": track.rods_seen,
        "noise_px": track.noise,
        "angle_noise_mrad": 1e3 * track.angle_noise,
        "covariance_inflation": track.inflation,
        "off_circle_px": track.off_circle,
        "turning_mrad": 1e3 * track.turning,
        "amplitude_rad": float(np.nanquantile(track.angles[:, 0], 0.99) - np.nanquantile(track.angles[:, 0], 0.01)) / 2,
    }
    if driven:
        result["dissipation"] = "It cannot be determined without the torque of the motor."
        return result
    if study is None:
        result["dissipation"] = "It cannot be determined: the motion is no free swing of at least three periods."
        return result
    return result | _of_study(track, study)


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
