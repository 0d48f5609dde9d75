"""Report what is installed, whether and how fast frames render, and what to do about what is missing."""

import json
import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from typing import Any

from packaging.requirements import Requirement
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from keycld_control import __version__
from keycld_control.cli._output import print_result

PROBE_TIMEOUT_S = 120
INSTALL_OPENGL = (
    "install a software renderer (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri), "
    "and run `keycld doctor` again"
)


@dataclass(frozen=True)
class Args:
    """Report what is installed, whether and how fast frames render, and what to do about what is missing.

    Attributes:
        json: Print one JSON object.
    """

    json: bool = False


def run(args: Args) -> None:
    """Examine and print; exit code 0 whatever is found, `ok` says whether everything works."""
    report = examine()
    if args.json:
        print_result(report, as_json=True)
    else:
        _print(report)


def examine() -> dict[str, Any]:
    """The state of this installation.

    Returns:
        ok, python, platform, cpus, packages (name -> version, required, ok), opengl (backend, renderer, error),
        frames_per_second (quality -> acrobot steps with a 64×64 frame, one process; None without OpenGL), and
        advice, a list of sentences that is empty when ok.
    """
    packages = _packages()
    opengl = _opengl()
    advice = [
        f"{name} is {found['version'] or 'missing'}, but {found['required']} is required: "
        f"{sys.executable} -m pip install '{found['required']}'."
        for name, found in packages.items()
        if not found["ok"]
    ]
    if opengl["error"]:
        chosen = os.environ.get("MUJOCO_GL")
        first = f"unset MUJOCO_GL, which is {chosen!r}, or " if chosen else ""
        advice.append(f"No frames can be rendered: {first}{INSTALL_OPENGL}.")
    return {
        "ok": not advice,
        "keycld": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpus": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "packages": packages,
        "frames_per_second": opengl.pop("frames_per_second"),
        "opengl": opengl,
        "advice": advice,
    }


def _packages() -> dict[str, dict[str, Any]]:
    found = {}
    for line in requires("keycld") or []:
        requirement = Requirement(line)
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            installed = None
        fits = installed is not None and requirement.specifier.contains(installed, prereleases=True)
        required = line.partition(";")[0].strip()
        found[requirement.name] = {"version": installed, "required": required, "ok": fits}
    return found


def _opengl() -> dict[str, Any]:
    failed = {"backend": os.environ.get("MUJOCO_GL"), "renderer": None, "frames_per_second": None}
    try:
        done = subprocess.run(
            [sys.executable, "-m", "keycld_control.cli._probe"],
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT_S,
            check=False,
        )
        return json.loads(done.stdout.splitlines()[-1])
    except subprocess.TimeoutExpired:
        return failed | {"error": f"rendering did not finish within {PROBE_TIMEOUT_S} s"}
    except (IndexError, ValueError):
        reason = done.stderr.strip().splitlines()[-1:] or [f"the renderer ended with code {done.returncode}"]
        return failed | {"error": reason[0]}


def _print(report: dict[str, Any]) -> None:
    console = Console()
    table = Table(box=box.SIMPLE)
    for column in ("package", "version", "required"):
        table.add_column(column)
    for name, found in report["packages"].items():
        style = None if found["ok"] else "bold red"
        table.add_row(name, found["version"] or "missing", escape(found["required"]), style=style)
    console.print(table)
    opengl, speed = report["opengl"], report["frames_per_second"] or {}
    summary = Table(box=box.SIMPLE, show_header=False)
    summary.add_row("keycld", report["keycld"])
    summary.add_row("Python", report["python"])
    summary.add_row("platform", f"{report['platform']}, {report['cpus']} CPU(s)")
    summary.add_row("OpenGL", opengl["error"] or f"{opengl['backend']}, {opengl['renderer']}")
    summary.add_row("frames/s", ", ".join(f"{quality} {rate:g}" for quality, rate in speed.items()) or "–")
    console.print(summary)
    for sentence in report["advice"]:
        console.print(f"[bold red]To do:[/] {escape(sentence)}", highlight=False)
    if report["ok"]:
        console.print("Everything works.")
