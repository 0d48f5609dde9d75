"""Agents, closed loops and the command line of KeyCLD."""

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from keycld_control.agent import EnergyShapingAgent
    from keycld_control.joint_agent import JointAgent

__all__ = ["EnergyShapingAgent", "JointAgent"]
__version__ = version("keycld")


def __getattr__(name: str) -> Any:
    """Import an agent, and with it JAX, when it is asked for: `keycld --help` and `keycld doctor` do without."""
    if name == "EnergyShapingAgent":
        from keycld_control.agent import EnergyShapingAgent

        return EnergyShapingAgent
    if name == "JointAgent":
        from keycld_control.joint_agent import JointAgent

        return JointAgent
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
