"""Record a data set of a simulated system."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Record a data set of a simulated system. Run again with the same settings, it continues where it stopped.

    Attributes:
        system: Short name (`keycld systems` lists them), environment id, or your_module:id to import a module first.
        out: Folder of the data set.
        episodes: Number of recordings.
        steps: Frames per recording.
        policy: Excitation: "constant" (the paper's), "piecewise" (piecewise constant), or "release" (none).
        action_range: Actions are drawn within ± this bound; by default ±3, or the system's limits if tighter.
        velocity: Initial joint velocities are uniform within ± this bound.
        width: Frame width in pixels.
        height: Frame height in pixels.
        camera: Camera name, by default the system's own.
        render_quality: How exact shadows and edges are.
        workers: Number of processes; the result does not depend on it.
        seed: Seed of the data set.
        json: Print one JSON object.
    """

    system: Positional[str]
    out: Path
    episodes: int = 500
    steps: int = 50
    policy: str = "constant"
    action_range: float | None = None
    velocity: float = 0.0
    width: int = 64
    height: int = 64
    camera: str | None = None
    render_quality: Literal["fast", "full"] = "fast"
    workers: int = 1
    seed: int = 0
    json: bool = False


def run(args: Args) -> None:
    """Collect and print the summary."""
    from keycld_envs.collect import CollectSettings, collect
    from keycld_envs.recordings.weaknesses import SLOW

    settings = CollectSettings(
        env_id=args.system,
        steps=args.steps,
        policy=args.policy,
        action_range=args.action_range,
        velocity=args.velocity,
        width=args.width,
        height=args.height,
        camera=args.camera,
        render_quality=args.render_quality,
        seed=args.seed,
    )
    if args.width * args.height > SLOW:
        times = args.width * args.height / 64**2
        print(
            f"keycld: warning: Frames of {args.width}x{args.height} pixels take {times:.0f} times the time and memory "
            "of 64x64 in training; record with --width 64 --height 64, unless nothing shows at that size.",
            file=sys.stderr,
        )
    print_result(asdict(collect(args.out, settings, args.episodes, args.workers)), as_json=args.json)
