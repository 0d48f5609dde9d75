"""Thousands of damaged inputs: `make fuzz`, or python tests/reliability/fuzz.py --inputs 2000 --seed 0.

Each input is read in a process that may take 5 s and 1 GB; importing the library and writing the input do not count.
Prints a table, and what went wrong with the numbers that make it again (--only NUMBER).
"""

import argparse
import json
import multiprocessing
import random
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

SECONDS, GIGABYTES = 5.0, 1.0
OPTIONS = "options"
HERE = Path(__file__).parent


def one(seed: int, number: int, begin: Callable[[], object]) -> tuple[str, str, str]:
    """Damage one input and, after a call of `begin`, read it: its kind, what came of it, and details."""
    import damage

    from keycld_envs.errors import InputError

    rng = random.Random(f"{seed}/{number}")
    kinds = [*damage.TARGETS, None]
    target = kinds[number % len(kinds)]
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        if target is None:
            damage.OPTIONS_FOLDER = name
            begin()
            try:
                damage.try_options(rng)
            except InputError as error:
                return OPTIONS, *_sentence(error)
            except Exception:
                return OPTIONS, "traceback", traceback.format_exc()
            return OPTIONS, "accepted", ""
        path, how = target.make(folder), rng.choice(list(damage.DAMAGES))
        whole, before = path.read_bytes(), target.read(folder)
        content = damage.DAMAGES[how](whole, rng)
        if content == whole:
            return target.name, "unchanged", how
        path.write_bytes(content)
        begin()
        try:
            after = target.read(folder)
        except InputError as error:
            return target.name, *_sentence(error)
        except Exception:
            return target.name, "traceback", f"{how}: {traceback.format_exc()}"
        if after == before:
            return target.name, "the same", how
        return target.name, "accepted although changed" if target.sealed else "another text", how


def _sentence(error: Exception) -> tuple[str, str]:
    """Refused, if in one line."""
    text = str(error)
    return ("refused", text) if "\n" not in text and len(text) < 2000 else ("traceback", f"no sentence: {text[:500]}")


def _work(connection: Connection, seed: int) -> None:
    sys.path[:0] = [str(HERE), str(HERE.parent / "model")]
    connection.send(("ready", "", "", 0.0))
    while (number := connection.recv()) is not None:
        begun = [time.perf_counter()]
        result = one(seed, number, lambda begun=begun: begun.append(time.perf_counter()))
        seconds = time.perf_counter() - begun[-1]
        peaks = [resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        connection.send((*result, seconds, max(peaks) / 1e6))


class Worker:
    """A process that reads inputs; it is replaced when it hangs, dies, or has become too large."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_work, args=(there, self._seed), daemon=True)
        self._process.start()
        there.close()
        self._here.recv()

    def read(self, number: int) -> tuple[str, str, str, float]:
        """What came of an input, and after how many seconds."""
        self._here.send(number)
        try:
            if not self._here.poll(SECONDS * 4):
                outcome = ("?", f"hang over {SECONDS:g} s", f"{number}", SECONDS * 4)
            else:
                kind, result, details, seconds, gigabytes = self._here.recv()
                if gigabytes <= GIGABYTES:
                    return kind, result, details, seconds
                outcome = (kind, f"above {GIGABYTES:g} GB", f"{gigabytes:.2f} GB", seconds)
        except EOFError:
            outcome = ("?", "traceback", f"the process died, exit code {self._process.exitcode}", 0.0)
        self._process.kill()
        self._start()
        return outcome

    def end(self) -> None:
        """Let the process end."""
        self._here.send(None)
        self._process.join()


def run(inputs: int, seed: int, only: int | None = None) -> dict[str, dict[str, int]]:
    """Counts by kind and outcome; failures are printed."""
    worker, counts, slowest = Worker(seed), {}, (0.0, 0)
    bad = ("traceback", f"hang over {SECONDS:g} s", f"above {GIGABYTES:g} GB", "accepted although changed")
    for number in range(inputs) if only is None else [only]:
        kind, outcome, details, seconds = worker.read(number)
        slowest = max(slowest, (seconds, number))
        if seconds > SECONDS and outcome not in bad:
            outcome = bad[1]
        counts.setdefault(kind, {}).setdefault(outcome, 0)
        counts[kind][outcome] += 1
        if outcome in bad or only is not None:
            print(f"{number}: {kind}: {outcome}: {details}", file=sys.stderr)
    worker.end()
    print(f"seed {seed}, {inputs} inputs, the slowest {slowest[0]:.2f} s, number {slowest[1]}", file=sys.stderr)
    return counts


def table(counts: dict[str, dict[str, int]]) -> str:
    """As Markdown."""
    outcomes = ["refused", "the same", "another text", "accepted", "unchanged", "traceback"]
    outcomes += sorted({o for row in counts.values() for o in row} - set(outcomes))
    lines = ["| input | " + " | ".join(outcomes) + " |", "|---" * (len(outcomes) + 1) + "|"]
    for kind, row in sorted(counts.items()):
        lines.append(f"| {kind} | " + " | ".join(str(row.get(o, 0)) for o in outcomes) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found = run(given.inputs, given.seed, given.only)
    print(json.dumps(found) if given.json else table(found))
    good = {"refused", "the same", "another text", "accepted", "unchanged"}
    sys.exit(0 if {outcome for row in found.values() for outcome in row} <= good else 1)
