"""The numbers behind the page's plots, as JSON."""

import base64
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_model.diagnosis.output.page.geometry import HINGE, skeleton
from keycld_model.diagnosis.output.words import effect_name
from keycld_model.diagnosis.verdict.evidence import Evidence, Residuals, Rollout
from keycld_model.diagnosis.verdict.report import Finding, Report

Array = NDArray[np.float64]
Json: TypeAlias = "str | int | float | bool | Mapping[str, Json] | Sequence[Json] | None"
"""A value of JSON."""
MOST, MOVING = 280_000, 150_000
"""Numbers in the plots and in the animations of a page, which keep it below 8 MB; more is thinned, or left out."""
FRAMES = 400
"""Most frames of an animation."""
LAGS = 20
"""Samples up to which residuals are correlated with themselves."""
BINS = np.linspace(-5, 5, 41)
"""Edges of the histograms of residuals over the sensor's noise."""


def plot_data(report: Report, evidence: Evidence) -> dict[str, Json]:
    """Everything that page.js draws; lines are packed as 32-bit floats in base 64."""
    model = evidence.nominal
    numbers = sum(3 * r.measured.size + len(r.time) for r in evidence.rollouts)
    numbers += sum(2 * r.before.size + len(r.time) for r in evidence.residuals)
    every = max(1, int(np.ceil(numbers / MOST)))
    return {
        "channels": [{"name": n, "unit": u} for n, u in zip(evidence.channels, evidence.units, strict=True)],
        "differs": report.verdict != "no_mismatch",
        "rollouts": [_rollout(r, every) for r in evidence.rollouts],
        "mechanism": _mechanism(model, evidence.rollouts),
        "residuals": [_residuals(r, every) for r in evidence.residuals],
        "whiteness": [_whiteness(evidence, i) for i in range(len(evidence.channels))],
        "bins": ((BINS[:-1] + BINS[1:]) / 2).tolist(),
        "when": [_when(i + 1, finding) for i, finding in enumerate(report.findings)],
    }


def _label(shown: Rollout | Residuals) -> str:
    """Which recording it is."""
    return f"{shown.recording} (baseline)" if shown.baseline else shown.recording


def _rollout(rollout: Rollout, every: int) -> dict[str, Json]:
    keep, breaks = _kept(len(rollout.time), rollout.starts, every)
    lines = {"measured": rollout.measured, "refitted": rollout.refitted, "corrected": rollout.corrected}
    return {
        "id": _label(rollout),
        "time": _broken(rollout.time[keep], breaks),
        **{name: [_broken(y[keep], breaks) for y in lines[name].T] for name in lines},
    }


def _residuals(residuals: Residuals, every: int) -> dict[str, Json]:
    keep, breaks = _kept(len(residuals.time), residuals.starts, every)
    return {
        "id": _label(residuals),
        "time": _broken(residuals.time[keep], breaks),
        "before": [_broken(z[keep], breaks) for z in residuals.before.T],
        "after": [_broken(z[keep], breaks) for z in residuals.after.T],
    }


def _mechanism(model: mujoco.MjModel, rollouts: tuple[Rollout, ...]) -> dict[str, Json]:
    """Links, and their ends in a plane over recordings, frame by frame, for the first recordings that fit."""
    shape, clips, budget = skeleton(model), [], MOVING
    for rollout in rollouts:
        keep = np.arange(0, len(rollout.time), max(1, int(np.ceil(len(rollout.time) / FRAMES))))
        budget -= 6 * len(shape.nodes) * len(keep)
        if budget < 0 and clips:
            break
        paths = [shape.at(pose[keep]) for pose in rollout.poses]
        clips.append({"time": _packed(rollout.time[keep]), "paths": [_packed(p) for p in paths]})
    return {
        "links": [[link.start, link.end] for link in shape.links],
        "slides": [j for j in range(model.njnt) if model.jnt_type[j] != HINGE],
        "nodes": len(shape.nodes),
        "clips": clips,
    }


def _whiteness(evidence: Evidence, channel: int) -> dict[str, Json]:
    """Histograms, autocorrelations and the share within two standard deviations, of a channel's residuals."""
    out: dict[str, Json] = {}
    new = [r for r in evidence.residuals if not r.baseline]
    sides = {name: [getattr(r, name)[:, channel] for r in new] for name in ("before", "after")}
    for name, residuals in sides.items():
        split = (np.split(z, r.starts[1:]) for z, r in zip(residuals, new, strict=True))
        pieces = [piece for parts in split for piece in parts if len(piece) > LAGS]
        z = np.concatenate(pieces) if pieces else np.zeros(0)
        z = z[np.isfinite(z)]
        counts, _ = np.histogram(np.clip(z, -4.999, 4.999), BINS)
        out[name] = {
            "density": (counts / max(1, len(z)) / (BINS[1] - BINS[0])).round(5).tolist(),
            "correlation": _correlation(pieces),
            "within": round(float(np.mean(np.abs(z) <= 2)), 4) if len(z) else None,
        }
        out["number"] = len(z)
    return out


def _correlation(pieces: list[Array]) -> list[float]:
    """Autocorrelation at lags from 0 to `LAGS`, within windows."""
    filled = [np.where(np.isfinite(piece), piece, 0.0) for piece in pieces]
    power = sum(float(z @ z) for z in filled) / max(1, sum(len(z) for z in filled))
    out = []
    for lag in range(LAGS + 1):
        product = sum(float(z[: len(z) - lag] @ z[lag:]) for z in filled)
        out.append(round(product / max(1, sum(len(z) - lag for z in filled)) / max(power, 1e-12), 4))
    return out


def _when(number: int, finding: Finding) -> dict[str, Json]:
    """Intervals to shade: for all recordings under "*", else by recording."""
    intervals = finding.when_by_recording or ({"*": finding.when} if finding.when else {})
    return {
        "number": number,
        "title": effect_name(finding.effect),
        "joint": finding.where["name"] if finding.where["kind"] == "joint" else None,
        "intervals": {key: [[float(t) for t in span] for span in spans] for key, spans in intervals.items()},
    }


def _kept(length: int, starts: NDArray[np.int64], every: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of samples to show, and where among them lines are broken."""
    keep = np.arange(0, length, every)
    return keep, np.unique(np.searchsorted(keep, starts[1:]))


def _broken(y: Array, breaks: NDArray[np.int64]) -> str:
    """A line as `_packed` has it, with NaN where it is broken."""
    return _packed(np.insert(y, breaks[breaks < len(y)], np.nan))


def _packed(y: Array) -> str:
    """Little-endian 32-bit floats in base 64."""
    return base64.b64encode(np.ascontiguousarray(y, dtype="<f4").tobytes()).decode("ascii")
