"""Gates on real recordings: what the diagnosis must show on mechanisms of other people (docs/real-data.md)."""

from keycld_control.benchmarks.real import r1, r2, r3, r4, r6
from keycld_control.benchmarks.real.gate import Curve, Gate, GateResult

GATES: dict[str, Gate] = {"R1": r1.run, "R2": r2.run, "R3": r3.run, "R4": r4.run, "R6": r6.run}
"""By name; R5 is about pixels."""

__all__ = ["GATES", "Curve", "Gate", "GateResult"]
