"""Swing up the reference systems with the shipped weights: a table, and a clip of each."""

from dataclasses import asdict, dataclass
from pathlib import Path

from keycld_control.cli._output import print_result

STARTS = ("random", "hanging")
REST = 2.0
"""Seconds at the target after which a clip ends."""


@dataclass(frozen=True)
class Args:
    """Swing up the reference systems with the shipped weights: a table, and a clip of each.

    Attributes:
        episodes: Episodes per system and start.
        out: Folder of the clips.
        workers: Number of processes.
        seed: Seed of the first episode of every row.
        json: Print one JSON object.
    """

    episodes: int = 3
    out: Path = Path("demo")
    workers: int = 1
    seed: int = 0
    json: bool = False


def run(args: Args) -> None:
    """Run, film, and print."""
    from keycld_control.closed_loop import LoopSettings
    from keycld_control.swingup import swing_up
    from keycld_control.video import film
    from keycld_envs.systems import REFERENCE_SYSTEMS

    args.out.mkdir(parents=True, exist_ok=True)
    rows, clips = [], []
    for system in REFERENCE_SYSTEMS:
        for start in STARTS:
            rows.append(swing_up(LoopSettings(system, start=start, seed=args.seed), args.episodes, args.workers))
        clips.append(args.out / f"{system}.mp4")
        film(LoopSettings(system, start="hanging", seed=args.seed), clips[-1], REST)
    if args.json:
        print_result({"rows": [asdict(row) for row in rows], "clips": [str(clip) for clip in clips]}, as_json=True)
        return

    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Swing-up from pixels: learned energy, one target image", box=box.SIMPLE)
    for column in ("system", "start", "success", "95 % interval", "upright after", "return", "act/s"):
        table.add_column(column, justify="left" if column in ("system", "start") else "right")
    for row in rows:
        table.add_row(
            row.system.removeprefix("KeyCLD/"),
            row.start,
            f"{row.successes}/{row.episodes}",
            f"{row.interval[0]:.2f} – {row.interval[1]:.2f}",
            f"{row.median_time_to_upright_s:.2f} s",
            f"{row.mean_return:.0f}",
            f"{row.act_per_second:.0f}",
        )
    console = Console()
    console.print(table)
    console.print("Clips: " + ", ".join(map(str, clips)), highlight=False)
