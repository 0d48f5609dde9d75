"""Runs a method on every case, without ever opening the answers."""

import json
import time
from functools import partial
from pathlib import Path
from typing import Any

from keycld_control.benchmarks.blind.make import SCHEMA, name
from keycld_control.benchmarks.blind.methods import METHODS, get_method
from keycld_control.benchmarks.unfinished import finish
from keycld_control.plain_json import plain
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file
from keycld_envs.reading import read_json
from keycld_envs.recordings import read_dataset
from keycld_model.diagnosis import Source


def run(out: Path, method: str = "diagnose", workers: int = 1, ray: str | None = None) -> dict[str, Any]:
    """Report on all cases that have no report yet.

    Args:
        out: folder of the benchmark.
        method: name or "module:function", see `methods`.
        workers: processes.
        ray: address of a Ray cluster to do it on instead.

    Returns:
        How many cases there are, were run now, and failed.

    Raises:
        InputError: if the folder holds no complete benchmark, or there is no such method.
    """
    manifest, folder = read_manifest(out), reports(out, method)
    get_method(method)
    every = range(manifest["cases"])
    todo = finish(
        partial(_run, out.resolve(), method),
        every,
        lambda: {i for i in every if (folder / f"{name(i)}.json").is_file()},
        folder,
        workers=workers,
        ray=ray,
    )
    done = [read_report(out, method, i) for i in every]
    failed = [r["case"] for r in done if r["failure"] is not None]
    return {"method": method, "cases": len(done), "run": todo, "failed": failed, "reports": str(folder)}


def read_report(out: Path, method: str, index: int) -> dict[str, Any]:
    """What a method's run on one case was written as.

    Raises:
        InputError: if it is missing or damaged.
    """
    path = reports(out, method) / f"{name(index)}.json"
    try:
        report = read_json(path)
        if isinstance(report, dict) and "failure" in report:
            return report
    except (OSError, ValueError):
        pass
    raise InputError(
        f"{path} is missing or damaged; remove it, and `keycld blind run {out} --method {method}` writes it again."
    )


def reports(out: Path, method: str) -> Path:
    """The folder of a method's reports."""
    return out / ("reports" if method == "diagnose" else f"reports-{method.replace(':', '.')}")


def read_manifest(out: Path) -> dict[str, Any]:
    """The manifest of a complete benchmark.

    Raises:
        InputError: if there is none.
    """
    path = out / "manifest.json"
    try:
        manifest = read_json(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is missing or damaged; `keycld blind make {out}` completes a benchmark.") from error
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        raise InputError(f"{path} has not the schema {SCHEMA!r}; make the benchmark anew with this version of keycld.")
    return manifest


def _run(out: Path, method: str, index: int) -> None:
    """Report on one case; an error is recorded as its failure and does not end the run."""
    wall, cpu, report, failure = time.perf_counter(), time.process_time(), None, None
    try:
        case = out / "cases" / name(index)
        training, held_out = (read_dataset(case / part).recordings for part in ("training", "held_out"))
        model = Source.of(None, training[0].system).model
        wall, cpu = time.perf_counter(), time.process_time()
        report = plain(get_method(method)(training, held_out, model))
    except Exception as error:
        failure = f"{type(error).__name__}: {error}"
    result = {
        "case": name(index),
        "method": method,
        "wall_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "failure": failure,
        "report": report,
    }
    with atomic_file(reports(out, method) / f"{name(index)}.json", "w") as file:
        json.dump(result, file, indent=1)
        file.write("\n")


__all__ = ["METHODS", "read_manifest", "reports", "run"]
