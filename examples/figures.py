"""Draw the clip of the README: the reference systems swing up, again and again, each from pixels and one target image.

python examples/figures.py --out docs/media/swingup.gif
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from PIL import Image, ImageColor

from keycld_control.closed_loop import LoopSettings, make_loop
from keycld_control.overlay import KEYPOINT
from keycld_control.video import CURVE, Moment, draw_clip, record
from keycld_envs.files import atomic_file
from keycld_envs.systems import REFERENCE_SYSTEMS


@dataclass(frozen=True)
class Args:
    """What to draw.

    Attributes:
        out: the clip.
        systems: from left to right.
        weights: folder with a checkpoint per system, named like it; by default the shipped weights.
        seconds: length of the clip.
        interval: seconds between frames, a multiple of 0.01.
        rest: seconds at the target before the next start.
        panel: width of a system, pixels.
        colours: colours of the clip.
        seed: of the first episode.
    """

    out: Path = Path("docs/media/swingup.gif")
    systems: tuple[str, ...] = REFERENCE_SYSTEMS
    weights: Path | None = None
    seconds: float = 8.0
    interval: float = 0.07
    rest: float = 0.8
    panel: int = 256
    colours: int = 128
    seed: int = 0


def draw_system(system: str, args: Args) -> Iterator[np.ndarray]:
    """Frames of one system: a hanging start, then random ones."""
    weights = None if args.weights is None else str(args.weights / system)
    moments: list[Moment] = []
    times = args.interval * np.arange(round(args.seconds / args.interval))
    seed, start, begin = args.seed, "hanging", 0.0
    while begin <= times[-1]:
        with make_loop(LoopSettings(system, weights, start)) as loop:
            while begin <= times[-1]:
                _, episode = record(loop, seed, args.rest)
                moments += [replace(moment, time=begin + moment.time) for moment in episode]
                begin, seed = moments[-1].time + loop.env.system.timestep, seed + 1
                if start == "hanging":
                    start = "random"
                    break
    shown = np.searchsorted([moment.time for moment in moments], times - 1e-9)
    mechanism, agent = loop.env.system.mechanism, loop.agent
    yield from draw_clip(
        [moments[i] for i in shown],
        mechanism,
        agent.target,
        agent.pivot,
        agent.target_energy,
        panel=args.panel,
        strip=72,
        label=f"{system}: learned energy",
    )


def write_gif(path: Path, pictures: list[Image.Image], interval: float, colours: int) -> None:
    """One palette for all pictures, so that what stands still costs nothing."""
    drawn = [np.full((40, pictures[0].width, 3), ImageColor.getrgb(name), np.uint8) for name in (KEYPOINT, CURVE)]
    sample = np.concatenate([np.asarray(picture) for picture in pictures[:: max(1, len(pictures) // 6)]] + drawn)
    palette = Image.fromarray(sample).quantize(colours)
    first, *others = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    with atomic_file(path) as file:
        first.save(
            file, "GIF", save_all=True, append_images=others, duration=round(1000 * interval), loop=0, optimize=True
        )


if __name__ == "__main__":
    args = tyro.cli(Args)
    clips = [list(draw_system(system, args)) for system in args.systems]
    pictures = [Image.fromarray(np.concatenate(row, axis=1)) for row in zip(*clips, strict=True)]
    write_gif(args.out, pictures, args.interval, args.colours)
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB, {len(pictures)} frames")
