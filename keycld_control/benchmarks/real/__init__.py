"""Gates on real recordings: what the diagnosis must show on mechanisms of other people (docs/real-data.md)."""

from keycld_control.benchmarks.real.declaration import gates, read_gate
from keycld_control.benchmarks.real.gate import Curve, Gate, GateResult
from keycld_control.benchmarks.real.runner import AnyGate, run

GATES: dict[str, AnyGate] = gates()
"""By name."""

__all__ = ["GATES", "AnyGate", "Curve", "Gate", "GateResult", "read_gate", "run"]
