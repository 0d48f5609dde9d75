"""Agents, closed loops and the command line of KeyCLD."""

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from keycld_control.agent import EnergyShapingAgent

__all__ = ["EnergyShapingAgent"]
__version__ = version("keycld")


def __getattr__(name: str) -> Any:
    """Import the agent, and with it JAX, when it is asked for: `keycld --help` and `keycld doctor` do without."""
    if name == "EnergyShapingAgent":
        from keycld_control.agent import EnergyShapingAgent

        return EnergyShapingAgent
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
