"""G6: a servo whose friction depends on its load."""

from collections.abc import Sequence
from dataclasses import replace

from keycld_control.benchmarks.real.gate import Outcome
from keycld_control.benchmarks.real.owners.all_rigs import SERVO
from keycld_control.benchmarks.real.owners.gate import OwnersGate
from keycld_control.benchmarks.real.owners.servo_friction import owners_models
from keycld_control.benchmarks.real.owners.versus import Versus

NAMED = ("load_dependent_friction", "coulomb_friction", "viscous_friction")


def check(found: Sequence[Versus]) -> Outcome:
    """All three kinds are named, and rollouts are no worse than those of the owners' best model."""
    (servo,) = found
    named = [f.effect for f in servo.report.findings]
    ratios = [c.ratio for c in servo.compared]
    words = ", ".join(f"{c.ratio:.2f} over {c.seconds:g} s" for c in servo.compared)
    return Outcome(
        f"{', '.join(named) or 'nothing'} named; error over that of m6 {words}",
        set(NAMED) <= set(named) and max(ratios) <= 1,
    )


GATE = OwnersGate(
    name="G6",
    title="servo, friction by load",
    required="load-dependent, Coulomb and viscous friction named; held-out error no worse than that of m6",
    rigs=[replace(SERVO, owners=lambda folder: owners_models(folder)[-1:], tested=True)],
    check=check,
)
