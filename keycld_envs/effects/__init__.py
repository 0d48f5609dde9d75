"""Physics that simulators leave out: one effect per file. Each names itself, prints itself, and changes one slot.

A new effect is a file and a line: the import here. Contract tests, searches and compiled programs pick it up.
"""

from keycld_envs.effects.actuator_dead_zone import ActuatorDeadZone as ActuatorDeadZone
from keycld_envs.effects.actuator_delay import ActuatorDelay as ActuatorDelay
from keycld_envs.effects.actuator_gain import ActuatorGain as ActuatorGain
from keycld_envs.effects.actuator_lag import ActuatorLag as ActuatorLag
from keycld_envs.effects.actuator_saturation import ActuatorSaturation as ActuatorSaturation
from keycld_envs.effects.added_inertia import AddedInertia as AddedInertia
from keycld_envs.effects.added_mass import AddedMass as AddedMass
from keycld_envs.effects.asymmetric_friction import AsymmetricFriction as AsymmetricFriction
from keycld_envs.effects.backlash import Backlash as Backlash
from keycld_envs.effects.base import Effect as Effect
from keycld_envs.effects.base import Parameter as Parameter
from keycld_envs.effects.base import parameter as parameter
from keycld_envs.effects.base_motion import BaseMotion as BaseMotion
from keycld_envs.effects.clock_drift import ClockDrift as ClockDrift
from keycld_envs.effects.cogging import Cogging as Cogging
from keycld_envs.effects.constant_force import ConstantForce as ConstantForce
from keycld_envs.effects.coulomb_friction import CoulombFriction as CoulombFriction
from keycld_envs.effects.edited import edited as edited
from keycld_envs.effects.end_stop import EndStop as EndStop
from keycld_envs.effects.external_periodic import ExternalPeriodic as ExternalPeriodic
from keycld_envs.effects.external_pulse import ExternalPulse as ExternalPulse
from keycld_envs.effects.friction_drift import FrictionDrift as FrictionDrift
from keycld_envs.effects.gain_drift import GainDrift as GainDrift
from keycld_envs.effects.gear_friction import GearFriction as GearFriction
from keycld_envs.effects.gravity_tilt import GravityTilt as GravityTilt
from keycld_envs.effects.hysteretic_friction import HystereticFriction as HystereticFriction
from keycld_envs.effects.joint_flexibility import JointFlexibility as JointFlexibility
from keycld_envs.effects.load_dependent_friction import LoadDependentFriction as LoadDependentFriction
from keycld_envs.effects.mass_drift import MassDrift as MassDrift
from keycld_envs.effects.position_dependent_friction import PositionDependentFriction as PositionDependentFriction
from keycld_envs.effects.quadratic_drag import QuadraticDrag as QuadraticDrag
from keycld_envs.effects.sensor_latency import SensorLatency as SensorLatency
from keycld_envs.effects.spring import Spring as Spring
from keycld_envs.effects.stribeck_friction import StribeckFriction as StribeckFriction
from keycld_envs.effects.viscous_friction import ViscousFriction as ViscousFriction

EFFECTS: dict[str, type[Effect]] = {
    kind.__module__.rsplit(".", 1)[1]: kind
    for kind in tuple(globals().values())
    if isinstance(kind, type) and issubclass(kind, Effect) and kind is not Effect
}
"""All effects that are imported here, by file. Drifts of different parameters have one id, and so have added masses and
frictions by a load."""


def effect_class(id: str, kind: str) -> type[Effect] | None:
    """The effect with an id at a kind of place; None if there is none."""
    return next((effect for effect in EFFECTS.values() if (effect.id, effect.kind) == (id, kind)), None)


def phrase(id: str) -> str:
    """Name of an effect's id inside a sentence: "Coulomb friction", "a spring"."""
    phrases = (kind.phrase for kind in EFFECTS.values() if kind.id == id)
    return next(phrases, "") or id.replace("_", " ").lower()
