"""Hundreds of killed commands: `make kills`, or python tests/reliability/kills.py --kills 200 --seed 0.

Every command is run whole twice; what the first run compiles the others find, as a user's do. Then it is begun again in
one folder, each time killed (SIGKILL, with its workers) after a random time, and at last left alone: what it ends with
must be what it ends with undisturbed.
"""

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
MODEL_TESTS = HERE.parent / "model"
KILLS_IN_A_ROW = 8
TRAIN = """
import sys
sys.path.insert(0, {tests!r})
import jax
from sharded import train_a_little
jax.config.update("jax_disable_most_optimizations", True)
from pathlib import Path
train_a_little(Path({out!r}))
"""
DIAGNOSE = """
import sys
sys.path.insert(0, {tests!r})
from plants import recordings
from keycld_envs.recordings import write_recording
for r in recordings("pendulum", 2, lambda t, q, v, u: -0.1 * v, number=6, seconds=1.5):
    write_recording({out!r} + "/" + r.id, r)
"""


@dataclass(frozen=True)
class Scenario:
    """A command that can be killed.

    Attributes:
        name: of it.
        command: with its words, for a folder to write to.
        digest: of what it has written, without times.
        prepare: makes the folder before the first run.
    """

    name: str
    command: Callable[[Path], list[str]]
    digest: Callable[[Path], str]
    prepare: Callable[[Path], object] = lambda out: out.mkdir(parents=True)


def keycld(*words: object) -> list[str]:
    """The command line."""
    return [sys.executable, "-m", "keycld_control", *map(str, words)]


def of_dataset(folder: Path) -> str:
    """Digest of recordings."""
    from keycld_envs.recordings import read_dataset

    return read_dataset(folder).sha256


def of_training(folder: Path) -> str:
    """Digest of the weights of a training, and of its log without times."""
    from keycld_model.checkpoint import flatten, read_checkpoint

    whole = hashlib.sha256()
    for name, array in sorted(flatten(read_checkpoint(folder)[0]).items()):
        whole.update(name.encode() + array.tobytes())
    for line in (folder / "log.jsonl").read_text().splitlines():
        whole.update(repr({k: v for k, v in json.loads(line).items() if k != "seconds"}).encode())
    return whole.hexdigest()


def without_times(value: Any) -> Any:
    """A report without seconds, folders and ids of processes."""
    if isinstance(value, dict):
        return {
            k: without_times(v)
            for k, v in value.items()
            if "second" not in k and not k.endswith("_s") and k != "reports"
        }
    return [without_times(v) for v in value] if isinstance(value, list) else value


def of_json(*patterns: str) -> Callable[[Path], str]:
    """Digest of JSON files."""

    def digest(folder: Path) -> str:
        files = sorted(path for pattern in patterns for path in folder.glob(pattern))
        content = [(str(p.relative_to(folder)), without_times(json.loads(p.read_text()))) for p in files]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest() if files else "nothing"

    return digest


def of_lines(folder: Path) -> str:
    """Digest of lines of results, in whatever order."""
    lines = [without_times(json.loads(line)) for line in (folder / "results.jsonl").read_text().splitlines()]
    return hashlib.sha256("".join(sorted(json.dumps(line, sort_keys=True) for line in lines)).encode()).hexdigest()


def delan(shared: Path) -> list[Scenario]:
    """Joint models: what is trained, the characters, and logs of a pendulum."""
    here = [sys.executable, str(HERE / "small_delan.py")]
    letters, logs, data = str(shared / "joints" / "letters.npz"), str(shared / "joints" / "logs"), shared / "joints"
    subprocess.run([*here, "data", str(data)], check=True)
    models = ["--model", "structured", "--model", "least_squares"]
    paper, real = ["--data", letters, "--seeds", "2", "--characters", "17"], ["--rig", "simple pendulum"]
    return [
        Scenario("delan train", lambda out: [*here, "train", letters, "--out", str(out)], of_training),
        Scenario(
            "delan paper", lambda out: [*here, "paper", "--out", str(out), *paper, *models], of_json("results/*.json")
        ),
        Scenario("delan real", lambda out: [*here, "real", logs, "--out", str(out), *real, *models], of_lines),
    ]


def scenarios(shared: Path, only: str | None = None) -> list[Scenario]:
    """All of them, or one; what they read lies in a shared folder."""
    runs = shared / "runs"
    if only in (None, "diagnose"):
        code = DIAGNOSE.format(tests=str(HERE.parent / "diagnosis"), out=str(runs))
        subprocess.run([sys.executable, "-c", code], check=True)
    collect = ["--episodes", 40, "--steps", 10, "--width", 16, "--height", 16, "--workers", 2]
    small = ["--cases", 2, "--seed", 3]
    made = shared / "blind"
    if only in (None, "blind run"):
        subprocess.run(keycld("blind", "make", made, *small), check=True, capture_output=True)

    every = [
        Scenario("collect", lambda out: keycld("collect", "pendulum", "--out", out, *collect), of_dataset),
        Scenario(
            "train", lambda out: [sys.executable, "-c", TRAIN.format(tests=str(MODEL_TESTS), out=str(out))], of_training
        ),
        Scenario(
            "diagnose", lambda out: keycld("diagnose", runs, "--env", "pendulum", "--out", out), of_json("report.json")
        ),
        Scenario("blind make", lambda out: keycld("blind", "make", out, *small), of_json("answers.json")),
        Scenario(
            "blind run",
            lambda out: keycld("blind", "run", out, "--method", "refit"),
            of_json("reports-refit/*.json"),
            lambda out: shutil.copytree(made, out),
        ),
        Scenario(
            "paper",
            lambda out: [sys.executable, str(HERE / "small_paper.py"), str(out)],
            of_json("results/*.json"),
        ),
        *(delan(shared) if only is None or only.startswith("delan") else []),
    ]
    return [scenario for scenario in every if only in (None, scenario.name)]


def one_run(scenario: Scenario, out: Path, seconds: float | None = None) -> tuple[float, int | None]:
    """Run a command, killed after a time if one is given: how long it took, and its exit code, None if killed."""
    begun = time.perf_counter()
    if not out.exists():
        scenario.prepare(out)
    with subprocess.Popen(
        scenario.command(out), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        try:
            _, errors = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return time.perf_counter() - begun, None
    if process.returncode not in (0, 10, 11):
        raise RuntimeError(f"{scenario.name} ended with {process.returncode}: {errors.decode()[-2000:]}")
    return time.perf_counter() - begun, process.returncode


def run(kills: int, seed: int, folder: Path, only: str | None = None) -> dict[str, dict[str, int]]:
    """Kill every command in turn."""
    rng, counts = random.Random(seed), {}
    chosen = scenarios(folder, only)
    for scenario in chosen:
        one_run(scenario, folder / "first" / scenario.name)
        whole = folder / "whole" / scenario.name
        seconds, _ = one_run(scenario, whole)
        wanted = scenario.digest(whole)
        row = counts[scenario.name] = {"kills": 0, "runs": 0, "lost or different": 0}
        while row["kills"] < -(-kills // len(chosen)):
            out = folder / "killed" / scenario.name
            shutil.rmtree(out, ignore_errors=True)
            for _ in range(KILLS_IN_A_ROW):
                if one_run(scenario, out, rng.uniform(0.2, 1.1 * seconds))[1] is not None:
                    break
                row["kills"] += 1
            row["runs"] += 1
            try:
                one_run(scenario, out)
                same = scenario.digest(out) == wanted
            except Exception as error:
                same = False
                print(f"{scenario.name}: {error}", file=sys.stderr)
            row["lost or different"] += not same
        print(f"{scenario.name}: {seconds:.1f} s undisturbed, {row}", file=sys.stderr, flush=True)
    return counts


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = f"{name}/compiled"
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        found = run(given.kills, given.seed, Path(name), given.only)
    if given.json:
        print(json.dumps(found))
    else:
        print("| command | kills | runs to the end | lost or different |\n|---|---|---|---|")
        print(
            "\n".join(
                f"| {name} | {r['kills']} | {r['runs']} | {r['lost or different']} |" for name, r in found.items()
            )
        )
    sys.exit(any(row["lost or different"] for row in found.values()))
