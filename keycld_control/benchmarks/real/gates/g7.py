"""G7: corrected simulators against what the owners of six mechanisms identified."""

from collections.abc import Sequence

from keycld_control.benchmarks.real.gate import Outcome
from keycld_control.benchmarks.real.owners.all_rigs import RIGS
from keycld_control.benchmarks.real.owners.gate import OwnersGate
from keycld_control.benchmarks.real.owners.versus import Versus

LEAST, WORSE = 5, 1.05
"""Mechanisms on which all rollouts must be better, and how much worse, relative, any may be."""


def check(found: Sequence[Versus]) -> Outcome:
    """A mechanism is won if rollouts of all lengths are better."""
    won = [one.name for one in found if all(c.ratio < 1 for c in one.compared)]
    worst = max(c.ratio for one in found for c in one.compared)
    words = "; ".join(f"{one.name} {', '.join(f'{c.ratio:.2f}' for c in one.compared)}" for one in found)
    return Outcome(
        f"better on {len(won)} of {len(found)}, at worst {worst:.2f} times the owners' error ({words})",
        len(won) >= LEAST and worst <= WORSE,
        {"won": won},
    )


GATE = OwnersGate(
    name="G7",
    title="against the owners' models",
    required="rollouts of .2, .5 and 1 s better on 5 of 6 mechanisms, nowhere worse by more than 5 %",
    rigs=RIGS,
    check=check,
)
