"""One gate per module, as its `GATE`; a module that is added to this folder is found."""

from importlib import import_module
from pkgutil import iter_modules

from keycld_control.benchmarks.real.concealed import ConcealedGate
from keycld_control.benchmarks.real.gate import Gate
from keycld_control.benchmarks.real.owners.gate import OwnersGate


def find_gates() -> dict[str, Gate | ConcealedGate | OwnersGate]:
    """All gates by name, in the order of their names."""
    found: list[Gate | ConcealedGate | OwnersGate] = [
        import_module(f"{__name__}.{module.name}").GATE for module in iter_modules(__path__)
    ]
    return {gate.name: gate for gate in sorted(found, key=lambda gate: gate.name)}
