"""A learned Lagrangian as an MJCF document: point masses on rods, in the units of the image or of a system.

In those of the image, lengths are image units (1 from the middle of the image to its border), masses shares of the
total, so that forces and torques are per total mass; x is right, z up, as the camera looks. Motion alone leaves the
scale of all forces open; where the motors of a system are declared, their power tells it, and its slides tell metres:
in its units, joints count as the system's do, and torques are N m. The kinetic energy is the model's. Its weights need
not be in proportion to the masses, since a real link has an inertia and a moment; MuJoCo's compensation of gravity,
body by body, makes up the difference. A spring along a rail becomes its joint's. Networks may bend V and g beyond what
bodies under gravity and motors at joints can do; how much of both is left out is told.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_envs import system_of
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_model.added_effects import allowed_states, learned_power, weights_of
from keycld_model.joints import joint_scales, measured, wrapped
from keycld_model.lagrangian import Lagrangian
from keycld_model.learned_system import LearnedSystem
from keycld_model.physics import heavy_rods
from keycld_model.places import carried, inner_rods

Floats = NDArray[np.floating]
SUBSTEP = 0.0025
"""s, longest step of the integrator."""
SOFT = 0.02
"""Share of V, root mean square, below which a spring along a rail is none."""
COUPLED = 0.02
"""Share of a motor's largest torque, below which it is none at another joint."""
LEFT_OUT = 0.1
"""Share of V or g, root mean square, from which an MJCF document would be another mechanism."""


@dataclass(frozen=True)
class Units:
    """What the document counts in.

    Attributes:
        metre: units of length per image unit.
        power: learned power per unit of power; 1 where the total mass is 1.
        senses: `[J]` 1 or -1, of the joints in order of their keypoints: with or against rods' clockwise turn from up,
            and rails to the right.
        zeros: `[J]` positions of joints whose rods point up or on as the one before, and whose carriages are at the
            pivot, rad or lengths.
        of_system: these are the units of a system, rad, m and N m.
    """

    metre: float
    power: float
    senses: Floats
    zeros: Floats
    of_system: bool


class Spring(NamedTuple):
    """Along a slider's rail, image units: its stiffness, and how far from the pivot it is at rest."""

    stiffness: float
    rest: float


@dataclass(frozen=True)
class LearnedMjcf:
    """A document, and what it cannot hold.

    Attributes:
        xml: MJCF.
        joints: names, in order.
        units: what it counts in.
        of_potential: share of V, root mean square over configurations, that is no weight of the masses and no spring.
        of_inputs: the same of g: torques that depend on the configuration.
    """

    xml: str
    joints: tuple[str, ...]
    units: Units
    of_potential: float
    of_inputs: float

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The document, compiled."""
        return mujoco.MjModel.from_xml_string(self.xml)


def learned_mjcf(model: LearnedSystem, of_system: bool = False) -> LearnedMjcf:
    """What a world model has learned, as a mechanism that MuJoCo simulates.

    Joints are those of rods, in radians, clockwise from their rod before (from up, at the pivot), and of sliders, along
    the rail to the right. A camera "front" sees what the model's does. Effects beside the model are left out.

    Args:
        model: with rods and sliders that hold its masses.
        of_system: count joints as the model's system does, in rad, m and N m, in place of image units.

    Raises:
        InputError: if the model has no constraints, its keypoints do not each hang on one rod or slider, or V and g are
            not those of weights and of motors at the joints; of_system, if the model is of no system with motors.
    """
    if not model.constrained:
        raise InputError(f"The model {model.name} has no rods and sliders that hold its masses; MJCF needs such.")
    holders = _holders(model.mechanism)
    lagrangian = model.parts.lagrangian(model.parameters)
    x, _ = allowed_states(lagrangian.points)
    energies = np.asarray(jax.jit(jax.vmap(lagrangian.potential_energy))(x), float)
    heights = np.asarray(x, float).reshape(len(x), -1, 2)[..., 1]
    stretched = _stretched(lagrangian, x, energies)
    weights = weights_of(np.asarray(lagrangian.points.lumped, float), heights, energies - stretched.sum(axis=1))
    left = energies - stretched.sum(axis=1) - heights @ weights
    springs, left = _springs(lagrangian, x, stretched, left)
    of_potential = _share(left, energies)
    slopes = _slopes(model, holders, np.asarray(x, float))
    torques = np.einsum("pnj,pnm->pmj", slopes, np.asarray(jax.jit(jax.vmap(lagrangian.input_matrix))(x), float))
    gears = torques.mean(axis=0)
    of_inputs = float(np.sqrt(np.mean((torques - gears) ** 2) / np.mean(torques**2))) if torques.size else 0.0
    for name, share in (("potential energy", of_potential), ("inputs", of_inputs)):
        if not share < LEFT_OUT:
            raise InputError(
                f"The {name} of the model {model.name} is to {100 * share:.0f} % none of weights or of motors at "
                "joints, which is all that this MJCF document holds; train the model longer, or check its declaration."
            )
    joints, motors = _names(model, holders)
    plain = Units(1.0, 1.0, np.ones(len(joints)), np.zeros(len(joints)), False)
    units = _units_of_system(model, holders) if of_system else plain
    spec = _built(model, holders, joints, weights, springs, units)
    slides = np.array([isinstance(holder, Slider) for _, holder in holders])
    _add_motors(spec, joints, motors, gears * units.senses / np.where(slides, units.metre, 1.0) / units.power)
    spec.compile()
    return LearnedMjcf(spec.to_xml(), joints, units, of_potential, of_inputs)


def places_of(model: LearnedSystem, document: LearnedMjcf) -> Callable[[Floats], Floats]:
    """Joint positions `[..., J]` of a model's document, as a function of keypoints `[..., K, 2]`.

    They are those that the model's constraints allow; angles are in [-pi, pi) about their zeros.
    """
    points, units = model.parts.lagrangian(model.parameters).points, document.units
    indices = [_index(model.mechanism, holder) for _, holder in _holders(model.mechanism)]
    slides = np.array([index >= len(model.mechanism.rods) for index in indices])

    @jax.jit
    @jax.vmap
    def allowed(x: Array) -> Array:
        x, _ = points.project(x, jnp.zeros_like(x), 3)
        return measured(model.mechanism, points.pivot, x)

    def places(keypoints: Floats) -> Floats:
        flat = jnp.asarray(keypoints, jnp.float32).reshape(-1, 2 * model.mechanism.num_keypoints)
        found = np.asarray(allowed(flat), float)[:, indices].reshape(*np.shape(keypoints)[:-2], -1)
        return np.where(slides, units.metre * found, wrapped(found)) * units.senses + units.zeros

    return places


def _holders(mechanism: Mechanism) -> list[tuple[int, Rod | Slider]]:
    """Each keypoint, after those that it hangs on, and the one rod or slider that holds it."""
    held: dict[int, list[Rod | Slider]] = {k: [] for k in range(mechanism.num_keypoints)}
    for rod in mechanism.rods:
        held[rod.end].append(rod)
    for slider in mechanism.sliders:
        held[slider.keypoint].append(slider)
    for k, own in held.items():
        if len(own) != 1:
            raise InputError(
                f"Keypoint {k} is held by {len(own)} rods and sliders; as MJCF, each keypoint hangs on exactly one."
            )
    out: list[tuple[int, Rod | Slider]] = []
    while len(out) < len(held):
        placed = {k for k, _ in out}
        ready = [
            (k, own[0])
            for k, own in held.items()
            if k not in placed and (isinstance(own[0], Slider) or own[0].start is None or own[0].start in placed)
        ]
        if not ready:
            raise InputError("Rods of the mechanism form a ring; as MJCF, they hang on the pivot or on a slider.")
        out += ready
    return out


def _index(mechanism: Mechanism, holder: Rod | Slider) -> int:
    """Which number of `keycld_model.joints.measured` a rod or slider has."""
    if isinstance(holder, Rod):
        return mechanism.rods.index(holder)
    return len(mechanism.rods) + mechanism.sliders.index(holder)


def _units_of_system(model: LearnedSystem, holders: list[tuple[int, Rod | Slider]]) -> Units:
    """Rad, m, N m and N."""
    if model.system is None or not model.mechanism.num_actions:
        raise InputError(
            f"The model {model.name} was trained on no system with motors, which would tell N m; train it on "
            "recordings that name one."
        )
    system, lagrangian = system_of(model.system), model.parts.lagrangian(model.parameters)
    scales = joint_scales(system)
    power = learned_power(system, lagrangian.points, lagrangian.input_matrix)
    own = [int(np.flatnonzero(scales.order == _index(model.mechanism, holder))[0]) for _, holder in holders]
    metres = np.abs(scales.units[~scales.turns])
    metre = float(metres.mean()) if len(metres) else 1.0
    return Units(metre, power, np.sign(scales.units)[own], scales.zero[own], True)


def _names(model: LearnedSystem, holders: list[tuple[int, Rod | Slider]]) -> tuple[tuple[str, ...], list[str]]:
    """Of joints, in the order of their keypoints, and of motors: the system's own if it has as many of each kind."""
    kinds = ["slide" if isinstance(holder, Slider) else "hinge" for _, holder in holders]
    plain = tuple(f"{kind}_{k}" for kind, (k, _) in zip(kinds, holders, strict=True))
    motors = [f"motor_{i}" for i in range(model.mechanism.num_actions)]
    if model.system is None:
        return plain, motors
    system = system_of(model.system)
    own = {kind: [joint.name for joint in system.joints if joint.kind == kind] for kind in ("hinge", "slide")}
    if any(len(names) != kinds.count(kind) for kind, names in own.items()):
        return plain, motors
    in_order = {
        "hinge": [model.mechanism.rods.index(holder) for _, holder in holders if isinstance(holder, Rod)],
        "slide": [model.mechanism.sliders.index(holder) for _, holder in holders if isinstance(holder, Slider)],
    }
    names = {kind: iter([own[kind][i] for i in order]) for kind, order in in_order.items()}
    return tuple(next(names[kind]) for kind in kinds), list(system.actuators)


def _slopes(model: LearnedSystem, holders: list[tuple[int, Rod | Slider]], x: Floats) -> Floats:
    """How keypoints move with each joint, `[P, 2K, J]`, in configurations `[P, 2K]`."""
    points = x.reshape(len(x), -1, 2)
    out = np.zeros((*points.shape, len(holders)))
    for j, (k, holder) in enumerate(holders):
        moved = sorted(carried(model.mechanism, k))
        if isinstance(holder, Slider):
            out[..., j][:, moved] = holder.along
            continue
        start = model.pivot if holder.start is None else points[:, holder.start]
        arm = points[:, moved] - np.broadcast_to(start, points[:, 0].shape)[:, None]
        out[..., j][:, moved] = np.stack([arm[..., 1], -arm[..., 0]], axis=-1)  # clockwise
    return out.reshape(len(x), -1, len(holders))


def _share(left: Floats, whole: Floats) -> float:
    """Root mean square about the means; none of what is nothing."""
    size = float(np.std(whole))
    return float(np.std(left)) / size if size > 1e-9 else 0.0


def _stretched(lagrangian: Lagrangian, x: Array, energies: Floats) -> Floats:
    """`[P, S]` energy of the spring along each rail, at rest at the pivot; none of one that hardly counts."""
    energy = 0.5 * lagrangian.stiffness * jax.vmap(lagrangian.along_rails)(x) ** 2
    counts = np.std(energy, axis=0) > SOFT * np.std(energies)
    return np.where(counts, np.asarray(energy, float), 0.0)


def _springs(lagrangian: Lagrangian, x: Array, stretched: Floats, left: Floats) -> tuple[dict[Slider, Spring], Floats]:
    """The springs that count, and what they leave of energies `[P]` that weights left, at rest where least is left."""
    sliders, stiffness = lagrangian.mechanism.sliders, np.asarray(lagrangian.stiffness, float)
    counts = np.flatnonzero(stretched.any(axis=0))
    along = np.asarray(jax.vmap(lagrangian.along_rails)(x), float)[:, counts]
    arms = np.c_[along, np.ones(len(along))]
    pull = np.linalg.lstsq(arms, left, rcond=None)[0]
    rests = -pull[:-1] / stiffness[counts]
    springs = {sliders[i]: Spring(stiffness[i], float(rest)) for i, rest in zip(counts, rests, strict=True)}
    return springs, left - arms @ pull


def _built(
    model: LearnedSystem,
    holders: list[tuple[int, Rod | Slider]],
    joints: tuple[str, ...],
    weights: Floats,
    springs: dict[Slider, Spring],
    units: Units,
) -> mujoco.MjSpec:
    """Bodies, joints, camera and light."""
    spec, metre = mujoco.MjSpec(), units.metre
    spec.modelname = Path(model.name).name
    spec.compiler.degree = False
    spec.option.timestep = model.timestep / max(1, int(np.ceil(model.timestep / SUBSTEP - 1e-9)))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    gravity, height = float(weights.sum()), model.image_shape[0]  # the sum of all masses is one
    spec.option.gravity = [0.0, 0.0, -gravity * metre]
    spec.visual.headlight.ambient = [0.5, 0.5, 0.5]
    camera = spec.worldbody.add_camera(name="front", pos=[0, -10 * metre, 0], fovy=2 * metre * height / (height - 1))
    camera.proj = mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC
    camera.quat = [0.5**0.5, 0.5**0.5, 0.0, 0.0]  # looks along y, z is up
    pivot = [metre * float(model.pivot[0]), 0.0, metre * float(model.pivot[1])]
    levels = dict(zip((*model.mechanism.rods, *model.mechanism.sliders), model.level.tolist(), strict=True))
    links = _links(model)
    of_bodies = _weights_of_bodies(model.mechanism, links, weights)
    bodies: dict[int | None, Any] = {None: spec.worldbody}
    ends: dict[int | None, list[float]] = {None: pivot}
    for (k, holder), name, sense, zero in zip(holders, joints, units.senses, units.zeros, strict=True):
        if isinstance(holder, Slider):
            normal = np.asarray(holder.normal, float)
            off = metre * normal * levels[holder] / (normal @ normal)
            place = [pivot[0] + float(off[0]), 0.0, pivot[2] + float(off[1])]
            bodies[k], ends[k] = _carriage(spec.worldbody, k, place, metre), [0.0, 0.0, 0.0]
            joint = bodies[k].add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE)
            joint.axis = [sense * holder.along[0], 0, sense * holder.along[1]]
            if holder in springs:
                joint.stiffness[0] = springs[holder].stiffness / (units.power * metre**2)
                joint.springref = zero + sense * metre * springs[holder].rest
        else:
            end = [0.0, 0.0, metre * float(np.sqrt(2 * levels[holder]))]
            bodies[k], ends[k] = _link(bodies[holder.start], k, ends[holder.start], end, metre), end
            joint = bodies[k].add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, sense, 0])
        joint.ref = zero
        link, mass = links[k], links[k].mass / (units.power * metre**2)
        bodies[k].mass, bodies[k].explicitinertial = mass, True
        bodies[k].ipos = [link.centre * coordinate for coordinate in ends[k]]
        few = 1e-6 * mass * metre**2  # MuJoCo asks for some
        across = few + mass * link.radius**2 * float(np.dot(ends[k], ends[k]))
        bodies[k].inertia = [across, across, few]
        bodies[k].gravcomp = 1 - float(of_bodies[k]) / (link.mass * gravity) if gravity else 0.0
        bodies[k].add_site(name=f"keypoint_{k}", pos=ends[k], size=[0.03 * metre, 0, 0], rgba=[1.0, 0.85, 0.2, 1.0])
    return spec


class _Link(NamedTuple):
    """The mass at a keypoint with that of the rod that ends there.

    Attributes:
        mass: of both.
        centre: of mass, as a share of the way from the rod's start to the keypoint.
        radius: of gyration about it, as a share of the rod's length.
    """

    mass: float
    centre: float
    radius: float


def _links(model: LearnedSystem) -> list[_Link]:
    """One per keypoint."""
    masses, count = model.masses.astype(float), model.mechanism.num_keypoints
    links = [_Link(mass, 1.0, 0.0) for mass in masses[:count]]
    for (_, end), rod in zip(heavy_rods(model.mechanism, masses), masses[count:], strict=True):
        own, total = masses[end], masses[end] + rod
        links[end] = _Link(total, 1 - rod / total / 2, np.sqrt(own * rod) / total / 2)
    return links


def _weights_of_bodies(mechanism: Mechanism, links: list[_Link], weights: Floats) -> Floats:
    """`[K]` at the bodies' centres of mass, which pull as the given ones `[K]` do at the keypoints."""
    shares = np.diag([link.centre for link in links])
    for start, end in inner_rods(mechanism):
        shares[start, end] = 1 - links[end].centre
    return np.linalg.solve(shares, weights)


def _carriage(world: Any, keypoint: int, place: list[float], metre: float) -> Any:
    """A body that will slide."""
    body = world.add_body(name=f"carriage_{keypoint}", pos=place)
    size = [0.1 * metre, 0.04 * metre, 0.05 * metre]
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size, mass=0, rgba=_colour(keypoint))
    return body


def _link(parent: Any, keypoint: int, place: list[float], end: list[float], metre: float) -> Any:
    """A rod that will turn about a place of the body before it."""
    body = parent.add_body(name=f"link_{keypoint}", pos=place)
    ends, size = [0.0, 0.0, 0.0, *end], [0.025 * metre, 0, 0]
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=size, mass=0, rgba=_colour(keypoint))
    return body


def _colour(keypoint: int) -> list[float]:
    return [[0.25, 0.5, 0.85, 1.0], [0.9, 0.55, 0.2, 1.0], [0.35, 0.7, 0.4, 1.0]][keypoint % 3]


def _add_motors(spec: mujoco.MjSpec, joints: tuple[str, ...], motors: list[str], gears: Floats) -> None:
    """One motor per action, at its joint, or at a tendon that pulls at several.

    Args:
        spec: with joints.
        joints: their names.
        motors: names.
        gears: `[m, J]` torque of a unit of each action, per total mass.
    """
    for name, own in zip(motors, gears.tolist(), strict=True):
        largest = int(np.argmax(np.abs(own)))
        if all(abs(gear) <= COUPLED * abs(own[largest]) for j, gear in enumerate(own) if j != largest):
            motor = spec.add_actuator(name=name, target=joints[largest], trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.gear = [own[largest], 0, 0, 0, 0, 0]
            continue
        tendon = spec.add_tendon(name=f"{name}_pulls")
        for joint, gear in zip(joints, own, strict=True):
            tendon.wrap_joint(joint, gear)
        spec.add_actuator(name=name, target=tendon.name, trntype=mujoco.mjtTrn.mjTRN_TENDON)
