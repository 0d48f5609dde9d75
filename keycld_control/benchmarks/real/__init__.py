"""Gates on real recordings: what the diagnosis must show on mechanisms of other people (docs/real-data.md)."""

from keycld_control.benchmarks.real.concealed import ConcealedGate
from keycld_control.benchmarks.real.gate import Curve, Gate, GateResult
from keycld_control.benchmarks.real.gates import find_gates
from keycld_control.benchmarks.real.owners.gate import OwnersGate
from keycld_control.benchmarks.real.runner import run

GATES: dict[str, Gate | ConcealedGate | OwnersGate] = find_gates()
"""By name."""

__all__ = ["GATES", "ConcealedGate", "Curve", "Gate", "GateResult", "run"]
