"""A joint model as a MuJoCo model, so that what simulates and diagnoses MuJoCo models takes it, too.

Joints, motors, their names and the learned friction are MuJoCo's own. Inertias and weight are the networks', which the
model carries in its custom fields, so that copies of it are complete. The bodies that MuJoCo needs are one at each
joint, which turns or slides by itself with the joint's usual inertia, and one that is fixed, whose mass is the common
factor of all learned energies, and whose user data are what they are off by beside it (see `deviation`). MuJoCo's own
steps know nothing of the networks: `learned_dynamics` has them.
"""

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from numpy.typing import NDArray

from keycld_envs.effects import StribeckFriction
from keycld_envs.errors import InputError
from keycld_model.delan.config import JointConfig
from keycld_model.delan.deviation import Deviation
from keycld_model.delan.families import JointDynamics
from keycld_model.delan.model import JointModel
from keycld_model.delan.network import Parameters

Floats = NDArray[np.float64]
FIELD = "keycld_joint_model"
"""Name of the custom fields with the configuration and the parameters."""
ALL_LINKS = "all_links"
"""Name of the body whose mass is the common factor of all energies, and whose user data are their deviation."""
OWN_ERROR = "own error"
"""What coefficients of the deviation are called, with a number."""
STEP = 0.005
"""s, of the rig; what simulates it chooses its own."""
PADDED = 1024
"""Samples are filled up to a multiple of this, since each number of them is compiled anew."""


@dataclass(frozen=True)
class Motor:
    """A motor of a rig.

    Attributes:
        name: of the actuator.
        joint: name of its joint.
        torque: of one unit of its command, N m or N.
    """

    name: str
    joint: str
    torque: float = 1.0


def rig_of(model: JointModel, motors: Sequence[Motor]) -> mujoco.MjModel:
    """A joint model with motors, as a MuJoCo model.

    Raises:
        InputError: if the model has a feed-forward network, whose torques and accelerations do not belong together.
    """
    config = model.config
    if not model.conserves:
        raise InputError("A feed-forward network has no equations of motion to add effects to; train another family.")
    spec = mujoco.MjSpec()
    spec.option.gravity, spec.option.timestep = np.zeros(3), STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.compiler.degree = False
    spec.nuser_body = Deviation(config).number
    _add_body(spec, ALL_LINKS, np.ones(4))
    usual = np.abs(np.diag(model.mass_matrix(np.zeros(config.n))))
    for i, (name, kind, inertia) in enumerate(zip(config.joints, config.kinds, usual.tolist(), strict=True)):
        slides = kind == "slide"
        body = _add_body(spec, f"carried_by_{name}", np.array([inertia if slides else 1.0, *[inertia] * 3]))
        body.pos = [float(i), 0.0, 0.0]
        joint = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=name, type=joint, axis=[1, 0, 0] if slides else [0, 1, 0])
    for motor in motors:
        added = spec.add_actuator(name=motor.name, target=motor.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        added.gainprm[0] = motor.torque
    spec.add_text(name=FIELD, data=json.dumps(config.to_dict()))
    numbers = _flat(model)
    spec.add_numeric(name=FIELD, size=len(numbers), data=numbers)
    rig = spec.compile()
    for effect in model.effects:
        effect.edit(rig)
    return rig


def _add_body(spec: mujoco.MjSpec, name: str, inertial: Floats) -> Any:
    """A body with a mass and moments of inertia, about its own place."""
    return spec.worldbody.add_body(
        name=name, mass=float(inertial[0]), inertia=inertial[1:].tolist(), ipos=[0, 0, 0], explicitinertial=True
    )


def _flat(model: JointModel) -> Floats:
    with jax.enable_x64(True):
        return np.asarray(ravel_pytree(jax.tree.map(jnp.asarray, model.parameters))[0], np.float64)


@functools.lru_cache(maxsize=16)
def _unpacked(config: str, numbers: bytes) -> "LearnedDynamics":
    """Equal rigs share one object, and with it what is compiled."""
    known = JointConfig.from_dict(json.loads(config))
    with jax.enable_x64(True):
        template = jax.tree.map(jnp.asarray, JointDynamics(known).initial(0))
        parameters = jax.tree.map(np.asarray, ravel_pytree(template)[1](jnp.asarray(np.frombuffer(numbers))))
    return LearnedDynamics(JointModel(known, parameters))


def learned_dynamics(rig: mujoco.MjModel) -> "LearnedDynamics | None":
    """What moves the joints of a rig; None of an ordinary MuJoCo model."""
    i = mujoco.mj_name2id(rig, mujoco.mjtObj.mjOBJ_TEXT, FIELD)
    if i < 0:
        return None
    first, number = int(rig.text_adr[i]), rig.numeric(FIELD).id
    text = bytes(rig.text_data[first : first + int(rig.text_size[i]) - 1])  # the last one is zero
    first = int(rig.numeric_adr[number])
    numbers = rig.numeric_data[first : first + int(rig.numeric_size[number])]
    return _unpacked(text.decode(), np.ascontiguousarray(numbers, np.float64).tobytes())


def common_factor(rig: mujoco.MjModel) -> float:
    """Of all energies of a rig."""
    return float(rig.body(ALL_LINKS).mass[0])


def deviation(rig: mujoco.MjModel) -> Floats:
    """Coefficients of what the learned energies of a rig are off by, `[K]`: a view, which may be written to."""
    return rig.body_user[rig.body(ALL_LINKS).id]


def own_inertias(rig: mujoco.MjModel) -> Floats:
    """Of the bodies of a rig at each joint, `[n]`, which MuJoCo reckons with in place of what was learned."""
    slides = rig.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    return np.where(slides, rig.body_mass[rig.jnt_bodyid], rig.body_inertia[rig.jnt_bodyid, 2])


@dataclass(frozen=True, eq=False)
class LearnedDynamics:
    """Learned equations of motion, without friction.

    Attributes:
        model: the joint model.
    """

    model: JointModel

    def mass_and_bias(self, q: Array, v: Array, factor: Array, deviation: Array) -> tuple[Array, Array]:
        """Mass matrix `[n, n, N]` and bias forces `[n, N]`, to be traced.

        Args:
            q: `[n, N]` positions.
            v: `[n, N]` velocities.
            factor: `[N]` of the learned energies.
            deviation: `[K, N]` of them.
        """
        return jax.vmap(self._mass_and_bias, in_axes=-1, out_axes=-1)(q, v, factor, deviation)

    def _mass_and_bias(self, q: Array, v: Array, factor: Array, deviation: Array) -> tuple[Array, Array]:
        (equations, p), off, zero = self._equations, Deviation(self.model.config), jnp.zeros_like(v)
        bias, more = equations.inverse_dynamics(p, q, v, zero), {"coefficients": deviation}
        mass = equations.inertias(p, q, v)
        return factor * mass + off.mass_matrix(more, q), factor * bias + off.inverse_dynamics(more, q, v, zero)

    @functools.cached_property
    def deviations(self) -> int:
        """Number of coefficients of the deviation, K."""
        return Deviation(self.model.config).number

    def fading_friction(self, v: Array) -> Array | float:
        """Dry friction beyond the friction loss of joints, at velocities `[n, N]`: that of Stribeck's which fades."""
        stribeck = [e for e in self.model.effects if isinstance(e, StribeckFriction)]
        if not stribeck:
            return 0.0
        extra, fading = (np.array([getattr(e, name) for e in stribeck])[:, None] for name in ("extra", "vs"))
        return jnp.asarray(extra) * jnp.exp(-((v / fading) ** 2))

    def forces(self, q: Floats, v: Floats, a: Floats, factor: float, deviation: Floats) -> Floats:
        """Forces `[..., n]` that a motion needs; see `mass_and_bias`."""
        packed = np.stack([x.reshape(-1, x.shape[-1]) for x in (q, v, a)])
        padded = np.pad(packed, ((0, 0), (0, -packed.shape[1] % PADDED), (0, 0)), mode="edge")
        with jax.enable_x64(True):
            forces = np.asarray(self._forces(padded, factor, deviation))
        return forces[: packed.shape[1]].reshape(v.shape)

    @functools.cached_property
    def _forces(self) -> Any:
        (equations, p), off = self._equations, Deviation(self.model.config)

        def forces(x: Array, factor: Array, deviation: Array) -> Array:
            own = jax.vmap(lambda q, v, a: equations.inverse_dynamics(p, q, v, a))(*x)
            more = jax.vmap(lambda q, v, a: off.inverse_dynamics({"coefficients": deviation}, q, v, a))(*x)
            return factor * own + more

        return jax.jit(forces)

    @property
    def _equations(self) -> tuple[Any, Parameters]:
        return JointDynamics(self.model.config).equations, self.model.parameters["equations"]
