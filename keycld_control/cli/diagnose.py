"""Find physics that a simulator lacks, from recordings of joints or images."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result
from keycld_control.cli._simulator import simulator_of
from keycld_control.plain_json import write_json

if TYPE_CHECKING:
    from keycld_envs.recordings import Recording
    from keycld_model import JointModel, WorldModel
    from keycld_model.diagnosis import Report, Source
    from keycld_model.diagnosis.verdict.report import Finding

WRITTEN = ("report.json", "report.html", "corrected.xml", "corrected_model")
"""In the folder of a report."""


@dataclass(frozen=True)
class Args:
    """Find physics that a simulator lacks: where recordings differ from it, and what would mend it.

    The exit code is 0 if nothing is missing, 10 if something is, 11 if these recordings cannot tell.

    Attributes:
        recordings: Folder of recordings with joint positions or frames.
        env: Environment to compare with; by default the one that the recordings name.
        mjcf: MuJoCo XML file to compare with instead.
        model: Learned model to compare with instead: a folder that `keycld train` or `keycld delan train` wrote, or the
            name of shipped weights. A world model also reads the frames; no simulator is needed.
        baseline: Folder of recordings of the same mechanism from before, at least two; findings are what changed since.
        held_out: Folder of recordings to test findings on; by default a third of the recordings is held out.
        out: Folder for report.json, report.html (the same for people), and corrected.xml (the corrected simulator); of
            a learned model, corrected_model (another of its kind), too.
        budget: Seconds after which the best so far is reported, with what was not tried; by default all is tried.
        observe: What is compared: joint positions ("states"), positions that are read off the frames by drawing the
            simulator ("pixels"), or both.
        camera: Camera of the simulator that looked; by default the one that the recordings name, or the only one.
        workers: Processes that read frames.
        tracked: Positions were read off images of a camera; its errors (a view askew, a rolling shutter) are refitted.
        json: Print the report as one JSON object.
    """

    recordings: Positional[Path]
    env: str | None = None
    mjcf: Path | None = None
    model: str | None = None
    baseline: Path | None = None
    held_out: Path | None = None
    out: Path | None = None
    budget: float | None = None
    observe: Literal["states", "pixels", "both"] = "states"
    camera: str | None = None
    workers: int = 2
    tracked: bool = False
    json: bool = False


def run(args: Args) -> int:
    """Diagnose, write and print the report."""
    keep_compiled()
    from keycld_envs.recordings import read_dataset

    if args.out is not None:
        _check_out(args.out)
    recordings = read_dataset(args.recordings).recordings
    held_out = read_dataset(args.held_out).recordings if args.held_out else ()
    baseline = read_dataset(args.baseline).recordings if args.baseline else ()
    simulator = _simulator(args, recordings)
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
    report = _diagnosed(args, simulator, recordings, held_out, baseline)
    if args.out is not None:
        report = _write(report, simulator, args.out)
    _print(report, args)
    return report.exit_code


def _check_out(out: Path) -> None:
    """Refuse a folder in which the report would replace what no diagnosis wrote."""
    from keycld_envs.errors import InputError
    from keycld_envs.reading import read_json

    there = [out / name for name in WRITTEN if (out / name).exists()]
    try:
        own = "verdict" in read_json(out / WRITTEN[0])
    except (OSError, ValueError, TypeError):
        own = False
    if there and not own:
        raise InputError(f"{there[0]} was not written by a diagnosis; choose another folder.")


def _diagnosed(
    args: Args,
    simulator: "Source | JointModel | WorldModel",
    recordings: "Sequence[Recording]",
    held_out: "Sequence[Recording]",
    baseline: "Sequence[Recording]",
) -> "Report":
    """The report on what is observed."""
    from keycld_envs.errors import InputError
    from keycld_model import JointModel, WorldModel
    from keycld_model.diagnosis import diagnose, diagnose_by_world_model, diagnose_images

    if args.observe == "states" and args.camera is not None:
        raise InputError("--camera is of images; say --observe pixels, or leave it out.")
    if args.observe != "states" and args.tracked:
        raise InputError("--tracked is of joint positions in the recordings; leave it out beside --observe pixels.")
    if isinstance(simulator, WorldModel):
        if args.observe != "pixels" or args.camera is not None:
            raise InputError(
                f"{args.model} is a world model, which sees images: say --observe pixels, and no --camera."
            )
        return diagnose_by_world_model(recordings, simulator, held_out, baseline=baseline, budget=args.budget)
    if args.observe == "states":
        model = simulator if isinstance(simulator, JointModel) else simulator.model
        return diagnose(recordings, model, held_out, args.tracked, baseline=baseline, budget=args.budget)
    if isinstance(simulator, JointModel):
        raise InputError("A joint model has no camera; leave out --observe, or name a simulator that has, --mjcf.")
    return diagnose_images(
        recordings,
        simulator.model,
        held_out,
        args.camera,
        args.observe == "both",
        baseline=baseline,
        budget=args.budget,
        workers=args.workers,
    )


def _simulator(args: Args, recordings: "Sequence[Recording]") -> "Source | JointModel | WorldModel":
    """What is compared with the recordings."""
    from keycld_envs.errors import InputError

    given = [name for name in ("env", "mjcf", "model") if getattr(args, name) is not None]
    if len(given) > 1:
        raise InputError(f"There are {len(given)} simulators, {' and '.join(f'--{g}' for g in given)}; name one.")
    if args.model is not None:
        return _learned(args.model)
    return simulator_of(args.recordings, recordings, args.mjcf, args.env)


def _learned(source: str) -> "JointModel | WorldModel":
    """A learned model of either kind."""
    from keycld_model import JointModel, WorldModel
    from keycld_model.checkpoint import read_checkpoint
    from keycld_model.stored import find_model

    folder = find_model(source)
    return JointModel.load(folder) if "joint_model" in read_checkpoint(folder)[1] else WorldModel.load(source)


def _write(report: "Report", simulator: "Source | JointModel | WorldModel", out: Path) -> "Report":
    """Write the report, its page, and the corrected simulator; returns the report with what that does not have."""
    from keycld_envs.errors import InputError
    from keycld_model import JointModel, WorldModel
    from keycld_model.diagnosis import (
        Source,
        learned_simulator,
        write_corrected,
        write_corrected_joint_model,
        write_page,
    )

    environment = corrected = None
    unread = report.evidence is not None and not report.evidence.rollouts  # images that are not believed
    if isinstance(simulator, JointModel):
        if report.evidence is not None:
            left = write_corrected_joint_model(report.evidence, out / "corrected_model")
            report = _without(report, [*map(str, left), "own errors, which are refitted to the recordings at hand"])
    else:
        if isinstance(simulator, WorldModel):
            if not unread:
                report = _without(report, _write_corrected_world_model(report, simulator, out / "corrected_model"))
            document = learned_simulator(simulator)
            simulator = Source(document.model, document.xml)
        environment = simulator.environment
        if report.evidence is not None and simulator.mjcf is not None and not unread:
            try:
                write_corrected(report.evidence, simulator, out / "corrected.xml")
                corrected = "corrected.xml"
            except InputError as error:
                print(f"keycld: There is no corrected.xml: {error}", file=sys.stderr)
    if corrected is None:
        (out / "corrected.xml").unlink(missing_ok=True)  # of an earlier report
    write_json(out / "report.json", report.to_dict())
    write_page(report, out / "report.html", environment, corrected)
    return report


def _without(report: "Report", left: list[str]) -> "Report":
    """The report, with what a corrected model does not have."""
    return replace(report, details={**report.details, "not_in_corrected_model": left})


def _write_corrected_world_model(report: "Report", world: "WorldModel", folder: Path) -> list[str]:
    """Write a world model with what was found; returns what it cannot be given."""
    from keycld_control.correction.corrections import corrections_of
    from keycld_envs.errors import InputError

    try:
        effects, left = corrections_of(report.to_dict(), "report.json")
        world.with_effects(effects).save(folder)  # the simulator has none that it was given before
    except InputError as error:  # less friction than before, for instance, or no system whose joints could have any
        print(f"keycld: There is no corrected_model: {error}", file=sys.stderr)
        return [f"{finding.effect} at {finding.where['name']}" for finding in report.findings]
    return left


def _print(report: "Report", args: Args) -> None:
    """On stdout what was found, on stderr what was not tried."""
    from keycld_model.diagnosis.output.words import experiment

    for line in report.details.get("dropped", ()):
        print(f"keycld: left out, because numbers ran away: {line}", file=sys.stderr)
    for line in report.details.get("beyond_limits", ()):
        print(f"keycld: {line}; give it another range, if the motor's is.", file=sys.stderr)
    if not_tried := report.details.get("not_tried"):
        print(f"keycld: after {args.budget:g} s, not tried: {', '.join(map(str, not_tried))}", file=sys.stderr)
    if args.json:
        print_result(report.to_dict(), as_json=True)
        return
    print(report.headline)
    if report.next_experiment is not None:
        print(experiment(report.next_experiment))
    summary = {f"{f.effect} at {f.where['name']}": _sizes(f) for f in report.findings}
    errors = {"nominal": report.fit.nominal, "refitted": report.fit.refitted, "corrected": report.fit.corrected}
    units = {f"held-out error {name} ({report.fit.unit})": error for name, error in errors.items()}
    print_result({"verdict": report.verdict, **summary, **units, "held_out": report.held_out}, as_json=False)


def _sizes(finding: "Finding") -> str:
    """The parameters of a finding, and its confidence."""
    from keycld_model.diagnosis.output.words import measured

    sizes = [f"{name} = {measured(estimate)}" for name, estimate in finding.parameters.items()]
    return ", ".join([*sizes, f"confidence {finding.confidence:.2f}"])
