"""Several methods on the same cases of concealed effects, side by side."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from keycld_control.benchmarks.real.concealed import ConcealedGate, Running
from keycld_control.benchmarks.real.gate import GateResult
from keycld_control.benchmarks.real.rivals.methods import get_method

HEADER = ("method", "alarms", "named", "among all", "in set", "placed", "sized", "s", "refused")
"""Alarms where nothing changed; then, where something did, what was found of it, "sized" within 20 %."""


def ask(
    gate: ConcealedGate, folder: Path, methods: Sequence[str], running: Running
) -> Iterator[tuple[str, GateResult]]:
    """What each method reaches, one after another.

    Raises:
        InputError: if there is no such method.
    """
    for method in methods:
        get_method(method)
    for method in methods:
        yield method, gate.run(folder, replace(running, method=method))


def rows(results: Mapping[str, GateResult]) -> list[list[str]]:
    """A row of each method, under `HEADER`, with the median of the seconds."""
    out = []
    for method, result in results.items():
        n = result.numbers
        found = [f"{n[key]} of {n['concealed']}" for key in ("named", "among", "in_set", "placed")]
        seconds = f"{n['median_s']:.0f}, ≤ {n['longest_s']:.0f}"
        counts = [f"{n['alarms']} of {n['nulls']}", *found, f"{n['sized']} of {n['named']}"]
        out.append([method, *counts, seconds, str(n["failures"])])
    return out
