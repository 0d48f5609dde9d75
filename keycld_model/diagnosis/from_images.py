"""The diagnosis of what a camera saw: positions are read off the frames first, by a simulator or by a world model."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import STANDARD, Criteria
from keycld_model.diagnosis.diagnose import diagnose
from keycld_model.diagnosis.inputs.checks import check_commands, check_films, check_model
from keycld_model.diagnosis.inputs.observation import JointPositions, Observation
from keycld_model.diagnosis.inputs.observation.encoders_and_camera import EncodersAndCamera, check_encoders, joined
from keycld_model.diagnosis.output.pictures import pictures
from keycld_model.diagnosis.verdict.evidence import Evidence
from keycld_model.diagnosis.verdict.report import Estimate, FitErrors, Report, Unexplained
from keycld_model.image_alignment import Positions, read_positions
from keycld_model.image_alignment.calibration import MOST_ASTRAY
from keycld_model.learned_mjcf import LearnedMjcf, learned_mjcf
from keycld_model.learned_positions import learned_positions
from keycld_model.world_model import WorldModel

LEAST_SEEN = 0.5
"""Share of the frames of a recording, and of all, that must tell positions; between them, motion is hidden for too
long."""


def diagnose_images(
    recordings: Sequence[Recording],
    model: mujoco.MjModel,
    held_out: Sequence[Recording] = (),
    camera: str | None = None,
    encoders: bool = False,
    criteria: Criteria = STANDARD,
    baseline: Sequence[Recording] = (),
    budget: float | None = None,
    workers: int = 2,
) -> Report:
    """Find physics that a simulator lacks, from images.

    The simulator is drawn, and its joints are moved until its picture is that of each frame; the camera's pose, visible
    lengths, blur and light are fitted first. What is left of the camera's errors is refitted in the diagnosis. Where
    pictures and frames do not agree, no physics is named: the verdict is "undetermined", and says so.

    Args:
        recordings: with frames, and commands.
        model: the simulator, with a camera.
        held_out: recordings to test findings on, of other amplitudes and inputs.
        camera: name of the camera; by default the one that the recordings name, or the only one.
        encoders: the joint positions of the recordings are used beside the images.
        criteria: thresholds and priors.
        baseline: recordings of the same mechanism from before, at least two; see `diagnose`.
        budget: seconds for the search, see `diagnose`.
        workers: processes that read images.

    Returns:
        The report; `nuisance` has the camera's errors, `details["images"]` how far frames were trusted, and which
        recordings were left out because few of theirs tell positions.

    Raises:
        InputError: if frames or the camera are missing, or what `diagnose` raises.
    """
    if baseline and encoders:
        raise InputError("A baseline is compared by one sensor; observe states or pixels, not both.")
    every = [*recordings, *held_out, *baseline]
    check_model(model)
    check_commands(every, model)
    check_films(every, criteria.sizes.window)
    for recording in every if encoders else ():
        check_encoders(recording, model)
    positions = read_positions(every, model, camera, workers)
    if not _believed(positions, criteria):
        remedy = "Give the simulator the camera, the shapes and the colours of the scene."
        return _distrusted(positions, every, model, criteria, remedy)
    return _diagnosed(positions, every, len(recordings), len(held_out), model, encoders, criteria, budget)


def diagnose_by_world_model(
    recordings: Sequence[Recording],
    world: WorldModel,
    held_out: Sequence[Recording] = (),
    criteria: Criteria = STANDARD,
    baseline: Sequence[Recording] = (),
    budget: float | None = None,
) -> Report:
    """Find physics that a world model lacks, from images alone; nobody has to model the mechanism.

    The world model is the sensor and the simulator: its estimator reads joint positions off the frames, and what it has
    learned of masses, gravity and motors (`keycld_model.learned_mjcf`) is compared with their motion. Effects at joints
    are in the units of the model's system, rad, m and N m; of a model without one, in image units and per total mass.

    Args:
        recordings: with frames as the model was trained on, and commands.
        world: with rods and sliders that hold its masses.
        held_out: recordings to test findings on, of other amplitudes and inputs.
        criteria: thresholds and priors.
        baseline: recordings of the same mechanism from before, at least two; see `diagnose`. What the model has learned
            wrongly is in both, and does no harm.
        budget: seconds for the search, see `diagnose`.

    Returns:
        The report; `details` has the units, and what the simulator leaves out of the model.

    Raises:
        InputError: if frames are missing or of another size, the model has no constraints, or what `diagnose` raises.
    """
    document = learned_simulator(world)
    every = [*recordings, *held_out, *baseline]
    positions = learned_positions(every, world, document)
    if not _believed(positions, criteria):
        remedy = "Train a world model on recordings of this scene, in this light."
        report = _distrusted(positions, every, document.model, criteria, remedy)
    else:
        report = _diagnosed(positions, every, len(recordings), len(held_out), document.model, False, criteria, budget)
    about = {
        "world_model": world.name,
        "units": "rad, m, N m" if document.units.of_system else "rad, image units, per total mass",
        "left_out": {"potential_energy": document.of_potential, "inputs": document.of_inputs},
    }
    return replace(report, details={**report.details, **about})


def learned_simulator(world: WorldModel) -> LearnedMjcf:
    """The simulator that a world model is, in the units of its system if that has motors.

    Raises:
        InputError: see `learned_mjcf`.
    """
    return learned_mjcf(world, of_system=world.system is not None and world.mechanism.num_actions > 0)


def _diagnosed(
    positions: Positions,
    every: Sequence[Recording],
    training: int,
    held_out: int,
    model: mujoco.MjModel,
    encoders: bool,
    criteria: Criteria,
    budget: float | None,
) -> Report:
    """The report on positions that were read off the frames of recordings.

    Args:
        positions: of all recordings.
        every: the recordings, those held out after the first ones, a baseline last.
        training: number of the first ones.
        held_out: number of those held out.
        model: the simulator.
        encoders: the joint positions of the recordings are used beside the images.
        criteria: thresholds and priors.
        budget: seconds for the search.
    """
    seen = list(positions.recordings)
    lasting = np.sqrt(positions.together)  # as if samples were independent
    usual = np.concatenate(positions.errors) ** -2.0
    typical = np.nanmean(np.where(np.concatenate(positions.readable)[:, None], usual, np.nan), axis=0) ** -0.5
    observation: Observation = JointPositions(
        model, tracked=True, criteria=criteria, floor=typical * lasting, typical=typical, by_look=positions.by_look
    )
    if encoders:
        seen = [joined(own, read) for own, read in zip(every, seen, strict=True)]
        error = positions.error * lasting
        observation = EncodersAndCamera(model, error, criteria=criteria, by_look=positions.by_look)
    else:
        criteria = replace(criteria, spreads=replace(criteria.spreads, noise=criteria.spreads.noise_of_frames))
    parts = slice(training), slice(training, training + held_out), slice(training + held_out, None)
    now, test, before = (_mostly_seen(seen[part], positions.readable[part]) for part in parts)
    used = {r.id for r in (*now, *test, *before)}
    if before:
        report = diagnose(now, model, criteria=criteria, baseline=before, budget=budget)
    else:
        report = diagnose(now, model, test, False, observation, criteria, budget=budget)
    evidence = report.evidence
    if evidence is not None:
        evidence = replace(evidence, pictures=pictures(evidence.rollouts, every, positions, model))
    return replace(
        report,
        evidence=evidence,
        nuisance={**report.nuisance, **_camera(positions)},
        details={
            **report.details,
            "tracked": True,
            "images": _summary(positions, [r.id for r in every if r.id not in used]),
        },
    )


def _mostly_seen(recordings: Sequence[Recording], readable: Sequence[NDArray[np.bool_]]) -> Sequence[Recording]:
    """Without those in which what moves is hidden, or has left the image, for most of the time; all if none is left."""
    return [r for r, f in zip(recordings, readable, strict=True) if np.mean(f) >= LEAST_SEEN] or recordings


def _camera(positions: Positions) -> dict[str, Estimate]:
    """Errors of the camera with 90 % intervals."""
    out = {}
    for parameter, value, deviation in zip(
        positions.parameters, positions.values, positions.value_deviation, strict=True
    ):
        low, high = value - 1.645 * deviation, value + 1.645 * deviation
        numbers = [float(np.exp(x)) if parameter.factor else float(x) for x in (value, low, high)]
        out[parameter.label] = Estimate(numbers[0], parameter.unit, *numbers[1:])
    return out


def _summary(positions: Positions, left_out: list[str]) -> dict[str, object]:
    """How far the frames are trusted, and which recordings hardly show the mechanism, JSON-compatible."""
    shares = {
        r.id: round(float(np.median(e)), 4) for r, e in zip(positions.recordings, positions.explained, strict=True)
    }
    error = [round(float(e), 6) for e in positions.error]
    together = [round(float(n), 2) for n in positions.together]
    return {
        "trusted_frames": round(positions.trusted, 4),
        "read_frames": round(positions.read, 4),
        "explained": shares,
        "error": error,
        "frames_together": together,
        "read_astray": round(positions.astray, 4),
        "repeated": positions.repeated,
        "left_out": left_out,
    }


def _believed(positions: Positions, criteria: Criteria) -> bool:
    """Whether frames are the simulator's, and show enough of the mechanism."""
    return positions.trusted >= criteria.trusted_frames and positions.read >= LEAST_SEEN


def _why_distrusted(positions: Positions, criteria: Criteria) -> str:
    """Half a sentence."""
    if positions.astray > MOST_ASTRAY:
        return (
            f"{100 * positions.astray:.0f} % of the frames that were drawn at known positions are read elsewhere "
            f"({100 * MOST_ASTRAY:.0f} % may be): the camera and the lengths that were fitted are wrong"
        )
    if positions.trusted >= criteria.trusted_frames:
        return (
            f"The mechanism has left the image in {100 * (1 - positions.read):.0f} % of the frames "
            f"({100 * (1 - LEAST_SEEN):.0f} % may be without it)"
        )
    worst = min(range(len(positions.recordings)), key=lambda r: float(np.median(positions.explained[r])))
    share, name = max(0.0, float(np.median(positions.explained[worst]))), positions.recordings[worst].id
    return (
        f"Only {100 * positions.trusted:.0f} % of the frames show the simulator where it can be, "
        f"{100 * criteria.trusted_frames:.0f} % are needed (in recording {name!r} its picture explains "
        f"{100 * share:.0f} % of what moves): positions cannot be read off them"
    )


def _distrusted(
    positions: Positions, recordings: Sequence[Recording], model: mujoco.MjModel, criteria: Criteria, remedy: str
) -> Report:
    """The report that names no physics, since the pictures are not the simulator's."""
    if positions.trusted >= criteria.trusted_frames:  # the scene is the simulator's
        remedy = "Record from farther away, or motions that stay in the image."
    message = f"{_why_distrusted(positions, criteria)}, and nothing is said of physics. {remedy}"
    none = float("nan")
    return Report(
        verdict="undetermined",
        headline=message,
        findings=[],
        nuisance=_camera(positions),
        unexplained=Unexplained(True, 1.0, None, message),
        fit=FitErrors("not measured", "", none, none, none),
        held_out=[],
        details={"tracked": True, "images": _summary(positions, []), "not_tried": []},
        evidence=Evidence(
            nominal=model,
            refitted=model,
            effects=(),
            channels=(),
            units=(),
            noise=np.zeros(0),
            rollouts=(),
            residuals=(),
            of_sensors=False,
            pictures=pictures((), recordings, positions, model),
        ),
    )
