"""Ctrl-C at random times: `make interrupts`, or python tests/reliability/interrupts.py --interrupts 100 --seed 0.

Each command is begun in an empty folder and interrupted (SIGINT to it and its workers, as a terminal does; once, or
three times by who is impatient). It must end with exit code 130 within 3 s, say so in one line, and leave neither a
process, nor a temporary file, nor half a file. One that is done and only about to leave does not count.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from kills import DIAGNOSE, keycld  # noqa: E402

FIRST = 0.25
"""Seconds until Python itself has started, on a loaded machine; before that, Ctrl-C is not this library's."""
SOON = 3.0
"""Seconds within which everything must have ended."""
DONE = (0, 10, 11)
"""Exit codes of commands that have done what was asked for."""


def commands(shared: Path) -> dict[str, tuple[list[str], float]]:
    """Command for each name, with {out} for a folder of its own, and the latest second to interrupt it."""
    runs, data, letters = shared / "runs", shared / "data", str(shared / "joints" / "letters.npz")
    workers = ["--workers", 2]
    return {
        "swingup": (keycld("swingup", "pendulum", "--episodes", 100, "--video", "{out}/clip.mp4", *workers), 12.0),
        "evaluate": (keycld("evaluate", "pendulum", "--data", data), 10.0),
        "train": (keycld("train", "pendulum", "--data", data, "--out", "{out}/run"), 20.0),
        "collect": (keycld("collect", "pendulum", "--out", "{out}/data", "--episodes", 2000, *workers), 8.0),
        "diagnose": (keycld("diagnose", runs, "--env", "pendulum", "--out", "{out}/report"), 12.0),
        "delan": (keycld("delan", "train", letters, "--out", "{out}/arm"), 12.0),
        "blind make": (keycld("blind", "make", "{out}/blind", "--cases", 50, *workers), 10.0),
    }


def prepare(shared: Path) -> None:
    """What the commands read."""
    subprocess.run([sys.executable, str(HERE / "small_delan.py"), "data", str(shared / "joints")], check=True)
    code = DIAGNOSE.format(tests=str(HERE.parent / "diagnosis"), out=str(shared / "runs"))
    subprocess.run([sys.executable, "-c", code], check=True)
    collect = keycld("collect", "pendulum", "--out", shared / "data", "--episodes", 100)
    subprocess.run(collect, check=True, capture_output=True)


def living(session: int) -> list[str]:
    """Names of processes of a session that have not ended."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, rest = entry.read_text().rsplit(")", 1)
        except OSError:  # it has ended
            continue
        state, _, _, its_session = rest.split()[:4]
        if int(its_session) == session and state != "Z":
            found.append(name.split("(", 1)[1])
    return found


def interrupted(command: list[str], folder: Path, seconds: float, presses: int) -> dict[str, object] | None:
    """What was wrong with how a command ended; None if it had ended before."""
    out, temporary = folder / "out", folder / "tmp"
    out.mkdir(parents=True)
    temporary.mkdir()
    words = [word.format(out=out) for word in command]
    env = os.environ | {"TMPDIR": str(temporary)}
    with subprocess.Popen(
        words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True, env=env
    ) as process:
        time.sleep(seconds)
        if process.poll() is not None:
            return None
        begun = time.monotonic()
        for _ in range(presses):
            os.killpg(process.pid, signal.SIGINT)
            time.sleep(0.05)
        try:
            errors = process.communicate(timeout=20 * SOON)[1].decode()
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return {"seconds": 20 * SOON, "hangs": True}
        while (left := living(process.pid)) and time.monotonic() - begun < SOON:
            time.sleep(0.02)
    wrong: dict[str, object] = {}
    if process.returncode in DONE and not left and time.monotonic() - begun < SOON:
        return None
    if process.returncode != 130:
        wrong["exit code"] = process.returncode
    if "keycld: interrupted" not in errors.splitlines() or "Traceback" in errors:
        wrong["says"] = errors[-2000:]
    if time.monotonic() - begun > SOON:
        wrong["seconds"] = time.monotonic() - begun
    if left:
        wrong["processes"] = left
        os.killpg(process.pid, signal.SIGKILL)
    if files := [str(p.relative_to(folder)) for p in (*temporary.iterdir(), *out.rglob("*.partial*"))]:
        wrong["files"] = files
    return wrong


def run(interrupts: int, seed: int, only: str | None = None) -> dict[str, dict[str, int]]:
    """Interrupt every command in turn."""
    rng, counts = random.Random(seed), {}
    with tempfile.TemporaryDirectory() as name:
        shared = Path(name)
        prepare(shared)
        chosen = {what: c for what, c in commands(shared).items() if only in (None, what)}
        for what, (command, latest) in chosen.items():
            row = counts[what] = {"interrupts": 0, "ended well": 0}
            tried = 0
            while row["interrupts"] < -(-interrupts // len(chosen)):
                tried += 1
                seconds, presses = rng.uniform(FIRST, latest), rng.choice([1, 3])
                wrong = interrupted(command, shared / f"{what} {tried}", seconds, presses)
                if wrong is None:
                    continue
                row["interrupts"] += 1
                row["ended well"] += not wrong
                if wrong:
                    print(f"{what}, after {seconds:.2f} s, {presses} times: {wrong}", file=sys.stderr, flush=True)
            print(f"{what}: {row}", file=sys.stderr, flush=True)
    return counts


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--interrupts", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found = run(given.interrupts, given.seed, given.only)
    if given.json:
        print(json.dumps(found))
    else:
        print("| command | interrupts | ended well |\n|---|---|---|")
        print("\n".join(f"| {name} | {r['interrupts']} | {r['ended well']} |" for name, r in found.items()))
    sys.exit(any(row["ended well"] < row["interrupts"] for row in found.values()))
