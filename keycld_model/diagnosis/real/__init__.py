"""Gates on real recordings: what the diagnosis must show on mechanisms of other people (docs/real-data.md)."""

from keycld_model.diagnosis.real.gate import Curve, Gate, GateResult
from keycld_model.diagnosis.real.r1 import r1
from keycld_model.diagnosis.real.r2 import r2
from keycld_model.diagnosis.real.r3 import r3
from keycld_model.diagnosis.real.r4 import r4
from keycld_model.diagnosis.real.r6 import r6

GATES: dict[str, Gate] = {"R1": r1, "R2": r2, "R3": r3, "R4": r4, "R6": r6}
"""By name; R5 is about pixels."""

__all__ = ["GATES", "Curve", "Gate", "GateResult"]
