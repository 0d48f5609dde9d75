"""Swing a system up from pixels, with learned weights, and count successes."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional, UseAppendAction

from keycld_control.cli._output import print_result

if TYPE_CHECKING:
    from keycld_envs.effects import Effect


@dataclass(frozen=True)
class Args:
    """Swing a system up from pixels, with learned weights and one target image, and count successes.

    Attributes:
        system: Short name (`keycld systems` lists them) or environment id.
        weights: Checkpoint, or name of shipped weights; by default those of the system.
        episodes: Number of episodes, of 1000 steps each.
        start: "random" angles at rest, or "hanging"; by default the environment's own.
        action_limit: Actions stay within ± this bound; by default the environment's.
        law: "turning", "projected" (the paper's on the constraint manifold) or "paper" (to the letter).
        kp: Stiffness, 1/s²; by default 40.
        kd: Damping, 1/s; by default 10.
        disturb: What the camera does to images, the target's included, as NAME=NUMBERS, again for another: shift=2 or
            shift=2,-1 (pixels to the right, up), zoom=1.02, roll=0.02, pitch=0.02, yaw=0.02 (rad), brightness=0.7 or
            brightness=1,0.9,0.8 (red, green, blue), offset=10 (grey levels), blur=0.7 (pixels), noise=10 (grey levels),
            jpeg=80 (quality).
        clean_target: The target image is undisturbed.
        corrections: report.json of `keycld diagnose`; the agent makes up for what it found.
        video: Write a clip of the whole first episode (.mp4 or .gif).
        workers: Number of processes; the result does not depend on it.
        seed: Seed of the first episode; the following ones count up.
        json: Print one JSON object.
    """

    system: Positional[str]
    weights: str | None = None
    episodes: int = 10
    start: Literal["random", "hanging"] | None = None
    action_limit: float | None = None
    law: Literal["turning", "projected", "paper"] = "turning"
    kp: float = 40.0
    kd: float = 10.0
    disturb: UseAppendAction[tuple[str, ...]] = ()
    clean_target: bool = False
    corrections: Path | None = None
    video: Path | None = None
    workers: int = 1
    seed: int = 0
    json: bool = False


def run(args: Args) -> None:
    """Run the episodes, film the first one if asked to, and print the statistics."""
    from keycld_control.cli._pairs import pairs
    from keycld_control.closed_loop import LoopSettings
    from keycld_control.swingup import swing_up
    from keycld_control.video import check_clip_path, film
    from keycld_envs.disturbance import Disturbance

    words = pairs("--disturb", args.disturb, "NUMBERS", "brightness=0.7")
    settings = LoopSettings(
        system=args.system,
        weights=args.weights,
        start=args.start,
        seed=args.seed,
        action_limit=args.action_limit,
        kp=args.kp,
        kd=args.kd,
        law=args.law,
        disturbance=Disturbance.parse(words) if words else None,
        clean_target=args.clean_target,
        corrections=() if args.corrections is None else _corrections(args.corrections),
    )
    if args.video is not None:
        check_clip_path(args.video)
    result = swing_up(settings, args.episodes, args.workers)
    if args.video is not None:
        film(settings, args.video)
    print_result(asdict(result), as_json=args.json)


def _corrections(path: Path) -> "tuple[Effect, ...]":
    """What a diagnosis found that a world model can be given."""
    from keycld_control.correction.corrections import corrections_of
    from keycld_envs.errors import InputError
    from keycld_envs.reading import read_json

    try:
        report = read_json(path)
    except (OSError, ValueError) as error:
        raise InputError(f"--corrections: {path} cannot be read ({error}); name a report.json.") from error
    effects, left = corrections_of(report, str(path))
    if left:
        raise InputError(f"--corrections: {path} has {', '.join(left)}, which agents cannot make up for; remove it.")
    return effects
