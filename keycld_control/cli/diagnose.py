"""Find physics that a simulator lacks, from recordings of joints or images."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result
from keycld_control.plain_json import write_json

if TYPE_CHECKING:
    from mujoco import MjModel

    from keycld_envs.recordings import Recording
    from keycld_model import JointModel
    from keycld_model.diagnosis import Report, Source
    from keycld_model.diagnosis.verdict.report import Finding


@dataclass(frozen=True)
class Args:
    """Find physics that a simulator lacks: where recordings differ from it, and what would mend it.

    The exit code is 0 if nothing is missing, 10 if something is, 11 if these recordings cannot tell.

    Attributes:
        recordings: Folder of recordings with joint positions or frames.
        env: Environment to compare with; by default the one that the recordings name.
        mjcf: MuJoCo XML file to compare with instead.
        model: Joint model to compare with instead, a folder that `keycld delan train` wrote.
        baseline: Folder of recordings of the same mechanism from before, at least two; findings are what changed since.
        held_out: Folder of recordings to test findings on; by default a third of the recordings is held out.
        out: Folder for report.json, report.html (the same for people), and corrected.xml (the corrected simulator); of
            a joint model, corrected_model (another joint model).
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
    model: Path | None = None
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
    from keycld_model import JointModel

    recordings = read_dataset(args.recordings).recordings
    held_out = read_dataset(args.held_out).recordings if args.held_out else ()
    baseline = read_dataset(args.baseline).recordings if args.baseline else ()
    simulator = _simulator(args, recordings)
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
    model = simulator if isinstance(simulator, JointModel) else simulator.model
    report = _diagnosed(args, model, recordings, held_out, baseline)
    if args.out is not None:
        report = _write(report, simulator, args.out)
    _print(report, args)
    return report.exit_code


def _diagnosed(
    args: Args,
    model: "MjModel | JointModel",
    recordings: "Sequence[Recording]",
    held_out: "Sequence[Recording]",
    baseline: "Sequence[Recording]",
) -> "Report":
    """The report on what is observed."""
    from keycld_envs.errors import InputError
    from keycld_model import JointModel
    from keycld_model.diagnosis import diagnose, diagnose_images

    if args.observe == "states":
        if args.camera is not None:
            raise InputError("--camera is of images; say --observe pixels, or leave it out.")
        return diagnose(recordings, model, held_out, args.tracked, baseline=baseline, budget=args.budget)
    if isinstance(model, JointModel):
        raise InputError("A joint model has no camera; leave out --observe, or name a simulator that has, --mjcf.")
    if args.tracked:
        raise InputError("--tracked is of joint positions in the recordings; leave it out beside --observe pixels.")
    encoders = args.observe == "both"
    return diagnose_images(
        recordings, model, held_out, args.camera, encoders, baseline=baseline, budget=args.budget, workers=args.workers
    )


def _simulator(args: Args, recordings: "Sequence[Recording]") -> "Source | JointModel":
    """What is compared with the recordings."""
    from keycld_envs.errors import InputError
    from keycld_model import JointModel
    from keycld_model.diagnosis import Source

    given = [name for name in ("env", "mjcf", "model") if getattr(args, name) is not None]
    if len(given) > 1:
        raise InputError(f"There are {len(given)} simulators, {' and '.join(f'--{g}' for g in given)}; name one.")
    if args.model is not None:
        return JointModel.load(args.model)
    if not given and len(systems := {r.system for r in recordings}) > 1:
        raise InputError(
            f"{args.recordings}, field system: the recordings name {len(systems)} simulators, "
            f"{', '.join(sorted(map(str, systems)))}; say which to compare with, --env, --mjcf or --model."
        )
    return Source.of(args.mjcf, args.env or recordings[0].system)


def _write(report: "Report", simulator: "Source | JointModel", out: Path) -> "Report":
    """Write the report, its page, and the corrected simulator; returns the report with what that does not have."""
    from keycld_envs.errors import InputError
    from keycld_model import JointModel
    from keycld_model.diagnosis import write_corrected, write_corrected_joint_model, write_page

    environment = corrected = None
    if isinstance(simulator, JointModel):
        if report.evidence is not None:
            left = write_corrected_joint_model(report.evidence, out / "corrected_model")
            others = [*map(str, left), "own errors, which are refitted to the recordings at hand"]
            report = replace(report, details={**report.details, "not_in_corrected_model": others})
    else:
        environment = simulator.environment
        if report.evidence is not None and simulator.mjcf is not None:
            try:
                write_corrected(report.evidence, simulator, out / "corrected.xml")
                corrected = "corrected.xml"
            except InputError as error:
                print(f"keycld: There is no corrected.xml: {error}", file=sys.stderr)
    write_json(out / "report.json", report.to_dict())
    write_page(report, out / "report.html", environment, corrected)
    return report


def _print(report: "Report", args: Args) -> None:
    """On stdout what was found, on stderr what was not tried."""
    from keycld_model.diagnosis.output.words import experiment

    for line in report.details.get("dropped", ()):
        print(f"keycld: left out, because numbers ran away: {line}", file=sys.stderr)
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
