"""The mechanisms of the real recordings as their owners describe them, without friction."""

from dataclasses import dataclass

import mujoco

# Steps as large as accuracy allows: the diagnosis also tries the model's own, and walks through them one by one.
_HEAD = """<mujoco><option timestep="{step}" gravity="0 0 {gravity}" integrator="RK4"><flag contact="disable"/></option>
<worldbody>"""


@dataclass(frozen=True)
class RigidLink:
    """A rigid link about its joint.

    Attributes:
        mass: kg.
        com: distance of its centre of mass from the joint, m.
        inertia: about the joint, kg m².
        armature: inertia of the rotor as the joint feels it, kg m².
    """

    mass: float
    com: float
    inertia: float
    armature: float = 0.0

    def inertial(self) -> str:
        """As MJCF."""
        about_com = self.inertia - self.mass * self.com**2
        if about_com <= 0:
            raise ValueError(f"The inertia {self.inertia:g} is below mass × com² = {self.mass * self.com**2:g}.")
        return (
            f'<inertial pos="0 0 {-self.com!r}" mass="{self.mass!r}" '
            f'diaginertia="{about_com!r} {about_com!r} {about_com / 100!r}"/>'
        )


def pendulum(link: RigidLink, *, motor: bool, turned: float = 0.0, gravity: float = 9.81) -> mujoco.MjModel:
    """One hinge, "hinge".

    Args:
        link: what swings.
        motor: with an actuator "motor", N m.
        turned: angle at which it hangs, degrees.
        gravity: m/s².
    """
    actuator = '<actuator><motor name="motor" joint="hinge"/></actuator>' if motor else ""
    return mujoco.MjModel.from_xml_string(
        _HEAD.format(step=0.01, gravity=-gravity)
        + f'<body name="link" euler="0 {turned!r} 0">{link.inertial()}'
        + f'<joint name="hinge" axis="0 1 0" armature="{link.armature!r}"/></body></worldbody>{actuator}</mujoco>'
    )


def double_pendulum(upper: RigidLink, lower: RigidLink, length: float, gravity: float = 9.81) -> mujoco.MjModel:
    """Hinges "shoulder" and "elbow", the second relative to the first, each with a motor of its name, N m.

    Args:
        upper: first link.
        lower: second link.
        length: of the first link, m.
        gravity: m/s².
    """
    return mujoco.MjModel.from_xml_string(
        _HEAD.format(step=0.005, gravity=-gravity)
        + f'<body name="upper">{upper.inertial()}<joint name="shoulder" axis="0 1 0" armature="{upper.armature!r}"/>'
        + f'<body name="lower" pos="0 0 {-length!r}">{lower.inertial()}'
        + f'<joint name="elbow" axis="0 1 0" armature="{lower.armature!r}"/></body></body></worldbody>'
        + '<actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator></mujoco>'
    )
