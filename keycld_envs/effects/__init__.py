"""Physics that simulators leave out: one effect per file. Each names itself, prints itself, and changes one slot."""

from keycld_envs.effects.actuator_dead_zone import ActuatorDeadZone
from keycld_envs.effects.actuator_delay import ActuatorDelay
from keycld_envs.effects.actuator_gain import ActuatorGain
from keycld_envs.effects.actuator_lag import ActuatorLag
from keycld_envs.effects.actuator_saturation import ActuatorSaturation
from keycld_envs.effects.added_inertia import AddedInertia
from keycld_envs.effects.added_mass import AddedMass
from keycld_envs.effects.asymmetric_friction import AsymmetricFriction
from keycld_envs.effects.backlash import Backlash
from keycld_envs.effects.base import Effect as Effect
from keycld_envs.effects.base import Parameter as Parameter
from keycld_envs.effects.base import parameter as parameter
from keycld_envs.effects.base_motion import BaseMotion
from keycld_envs.effects.clock_drift import ClockDrift
from keycld_envs.effects.cogging import Cogging
from keycld_envs.effects.constant_force import ConstantForce
from keycld_envs.effects.coulomb_friction import CoulombFriction
from keycld_envs.effects.end_stop import EndStop
from keycld_envs.effects.external_periodic import ExternalPeriodic
from keycld_envs.effects.external_pulse import ExternalPulse
from keycld_envs.effects.friction_drift import FrictionDrift
from keycld_envs.effects.gain_drift import GainDrift
from keycld_envs.effects.gravity_tilt import GravityTilt
from keycld_envs.effects.hysteretic_friction import HystereticFriction
from keycld_envs.effects.joint_flexibility import JointFlexibility
from keycld_envs.effects.load_dependent_friction import LoadDependentFriction
from keycld_envs.effects.mass_drift import MassDrift
from keycld_envs.effects.position_dependent_friction import PositionDependentFriction
from keycld_envs.effects.quadratic_drag import QuadraticDrag
from keycld_envs.effects.sensor_latency import SensorLatency
from keycld_envs.effects.spring import Spring
from keycld_envs.effects.stribeck_friction import StribeckFriction
from keycld_envs.effects.viscous_friction import ViscousFriction

EFFECTS: dict[str, type[Effect]] = {
    effect.__module__.rsplit(".", 1)[1]: effect
    for effect in (
        ActuatorDeadZone,
        ActuatorDelay,
        ActuatorGain,
        ActuatorLag,
        ActuatorSaturation,
        AddedInertia,
        AddedMass,
        AsymmetricFriction,
        Backlash,
        BaseMotion,
        ClockDrift,
        Cogging,
        ConstantForce,
        CoulombFriction,
        EndStop,
        ExternalPeriodic,
        ExternalPulse,
        FrictionDrift,
        GainDrift,
        GravityTilt,
        HystereticFriction,
        JointFlexibility,
        LoadDependentFriction,
        MassDrift,
        PositionDependentFriction,
        QuadraticDrag,
        SensorLatency,
        Spring,
        StribeckFriction,
        ViscousFriction,
    )
}
"""By file. Drifts of different parameters have one id, and so have rotors and masses that are added."""


def effect_class(id: str, kind: str) -> type[Effect] | None:
    """The effect with an id at a kind of place; None if there is none."""
    return next((effect for effect in EFFECTS.values() if (effect.id, effect.kind) == (id, kind)), None)
