"""From an MJCF document to swing-up in six commands, on mechanisms that the library has not: how well, in which time?

    python examples/new_mechanisms.py --out runs/new

It types the commands that a newcomer types, one after the other, and prints them with their minutes. What is done is
not done again, so the same command goes on where it was stopped. It takes twelve to twenty minutes a mechanism.
"""

import json
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from keycld_control.plain_json import write_json

DOCUMENTS = Path(__file__).with_name("mechanisms").resolve()
RANGE = {"cart_with_two_poles": 1.5}
"""`--action-range` that `keycld check` asks for, of light poles; the others are recorded with all that motors have."""


@dataclass(frozen=True)
class Args:
    """Learn and control new mechanisms.

    Attributes:
        out: folder for declarations, recordings and models.
        only: names of mechanisms; all of examples/mechanisms by default.
        recordings: of 50 frames, to learn from; a tenth of them is held out.
        episodes: swing-ups from random starts.
        seed: of recordings; that of the starts is 5000 more.
    """

    out: Path
    only: tuple[str, ...] = ()
    recordings: int = 200
    episodes: int = 100
    seed: int = 0


def commands(name: str, args: Args) -> list[str]:
    """What is typed."""
    narrow = f" --action-range {RANGE[name]}" if name in RANGE else ""
    return [
        f"new {name} --mjcf {shlex.quote(str(DOCUMENTS / name))}.xml",
        f"check {name}.py --out {name}.png",
        f"collect {name}.py --episodes {args.recordings} --out data/{name} --workers 2 --seed {args.seed}{narrow}",
        f"train {name}.py --data data/{name} --out runs/{name} --preset quick",
        f"evaluate runs/{name} --data data/{name}",
        f"swingup {name}.py --weights runs/{name} --episodes {args.episodes} --seed {args.seed + 5000} --workers 2",
    ]


def measure(name: str, args: Args) -> dict[str, Any]:
    """Type them, and keep what the last two said."""
    said: dict[str, Any] = {}
    minutes: dict[str, float] = {}
    for command in commands(name, args):
        print(f"keycld {command}", flush=True)
        started, verb = time.monotonic(), command.split()[0]
        words = [sys.executable, "-m", "keycld_control", *shlex.split(command), *(["--json"] if verb != "new" else [])]
        done = subprocess.run(words, cwd=args.out, stdout=subprocess.PIPE, text=True, check=True)
        said[verb] = done.stdout
        minutes[verb] = round((time.monotonic() - started) / 60, 2)
    evaluated, swung = (json.loads(said[verb]) for verb in ("evaluate", "swingup"))
    return {"mechanism": name, "minutes": minutes, "evaluate": evaluated, "swingup": swung}


def main(args: Args) -> None:
    """Print a line per mechanism."""
    args.out.mkdir(parents=True, exist_ok=True)
    found = []
    for name in args.only or sorted(path.stem for path in DOCUMENTS.glob("*.xml")):
        file = args.out / f"{name}.json"
        if not file.is_file():
            write_json(file, measure(name, args))
        found.append(json.loads(file.read_text(encoding="utf-8")))
    for each in found:
        scored, swung, minutes = each["evaluate"], each["swingup"], each["minutes"]
        print(
            f"{each['mechanism']:>20}  VPT {scored['vpt_fraction']:.3f}  swing-ups {swung['successes']} of "
            f"{swung['episodes']}  {len(minutes)} commands, {sum(minutes.values()):.1f} minutes "
            f"({sum(m for verb, m in minutes.items() if verb != 'swingup'):.1f} before the swing-ups)"
        )


if __name__ == "__main__":
    main(tyro.cli(Args))
