"""Commands on a disk that is full, and in folders that are read-only: python tests/reliability/disks.py.

Needs Linux and the rights to mount a file system (unshare); each command writes to a small disk of its own that has a
file of the user's on it. It must end with exit code 2 and one sentence, and leave that file and all complete content
as it was.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from kills import DIAGNOSE, keycld  # noqa: E402

IMPORTED = "t,angle\n" + "".join(f"{0.01 * k},{0.001 * k}\n" for k in range(20_000))


def commands(shared: Path) -> dict[str, tuple[list[str], int]]:
    """Command for each place that writes, with {disk} for the disk, and the KiB that are too few for it."""
    runs, log, data = shared / "runs", shared / "log.csv", shared / "data"
    collect = ["--episodes", 4, "--steps", 20]
    friction = ["--env", "pendulum", "--effect", "coulomb_friction", "--at", "hinge", "--set", "c=0.1"]
    return {
        "collect": (keycld("collect", "pendulum", "--out", "{disk}/data", *collect), 40),
        "collect, two workers": (keycld("collect", "cartpole", "--out", "{disk}/data", *collect, "--workers", 2), 40),
        "import": (
            keycld("import", log, "--out", "{disk}/r", "--time", "t", "--joint", "hinge=angle", "--unit", "angle=rad"),
            40,
        ),
        "conceal": (keycld("conceal", runs, *friction, "--out", "{disk}/concealed"), 24),
        "train": ([sys.executable, str(HERE / "small_train.py"), str(data), "{disk}/run"], 40),
        "swingup, video": (keycld("swingup", "pendulum", "--episodes", 1, "--video", "{disk}/clip.mp4"), 16),
        "diagnose": (keycld("diagnose", runs, "--env", "pendulum", "--out", "{disk}/report"), 24),
        "blind make": (keycld("blind", "make", "{disk}/blind", "--cases", 2, "--seed", 3), 40),
        "paper": (keycld("paper", "--out", "{disk}/paper", "--system", "pendulum", "--seeds", 1), 40),
        "demo": (keycld("demo", "--episodes", 1, "--out", "{disk}/demo"), 16),
    }


def prepare(shared: Path) -> None:
    """What the commands read."""
    code = DIAGNOSE.format(tests=str(HERE.parent / "diagnosis"), out=str(shared / "runs"))
    subprocess.run([sys.executable, "-c", code], check=True)
    collect = keycld("collect", "pendulum", "--out", shared / "data", "--episodes", 12)
    subprocess.run(collect, check=True, capture_output=True)
    (shared / "log.csv").write_text(IMPORTED)


def contents(folder: Path) -> dict[str, str]:
    """Digest of every complete file."""
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def in_a_small_disk(command: Sequence[str], disk: Path, size: int, read_only: bool) -> dict[str, object]:
    """Run in a mount of its own: exit code, what was said, and whether the user's file is still there."""
    options = f"size={size + 8}k" + (",ro" if read_only else "")
    keep = "" if read_only else f"echo mine > {disk}/mine.txt;"
    words = " ".join(f"'{word.format(disk=disk)}'" for word in command)
    script = (
        f"mount -t tmpfs -o {options} tmpfs {disk} && {keep} {words} >{disk}.out 2>{disk}.err; code=$?;"
        f"cat {disk}/mine.txt 2>/dev/null > {disk}.mine; find {disk} -name '*.partial*' > {disk}.left; exit $code"
    )
    done = subprocess.run(["unshare", "--mount", "--map-root-user", "sh", "-c", script], check=False)
    said = Path(f"{disk}.err").read_text().strip().splitlines()
    intact = read_only or Path(f"{disk}.mine").read_text() == "mine\n"
    good = done.returncode == 2 and intact and bool(said) and said[-1].startswith("keycld: ")
    good = good and not any(line.startswith("Traceback") for line in said)
    return {"exit": done.returncode, "said": said[-1][:160] if said else "", "good": good}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as name:
        shared = Path(name)
        prepare(shared)
        for what, (command, size) in commands(shared).items():
            if given.only not in (None, what):
                continue
            for read_only in (False, True):
                disk = shared / f"disk{len(found)}"
                disk.mkdir()
                place = f"{what}, {'read-only' if read_only else 'full'}"
                found[place] = in_a_small_disk(command, disk, size, read_only)
                print(place, found[place], file=sys.stderr, flush=True)
    if given.json:
        print(json.dumps(found))
    else:
        print("| place | exit code | says |\n|---|---|---|")
        print("\n".join(f"| {place} | {r['exit']} | {r['said']} |" for place, r in found.items()))
    sys.exit(not all(r["good"] for r in found.values()))
