"""`EnergyShapingAgent`: from one image per step to an action, with a world model and one target image."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from numbers import Real
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jax import Array
from numpy.typing import ArrayLike, NDArray

from keycld_control.actuation import Actuation, Outlook
from keycld_control.law import LAWS, Law
from keycld_control.limit_cycle import Swinging, no_swinging, watched
from keycld_control.limits import action_bounds
from keycld_control.observer import Estimate, choose, first_estimate, predicted
from keycld_control.plant import KEYPOINT_NOISE, LearnedModel, Plant, advanced, energy, project, responses
from keycld_control.plausibility import Plausibility, expect, shows_mechanism
from keycld_control.pumping import Pump, PumpState, first_pump_state, plan_pumping, pumping_action
from keycld_control.targets import check_image, find_target, roughly
from keycld_control.trust import Trust, first_trust, judged, trusted
from keycld_envs.checks import short
from keycld_envs.errors import InputError
from keycld_model.camera import Camera, Restoration, restore, restored

DEFAULT_KP, DEFAULT_KD = 40.0, 10.0
ROBUST, BRAKING = 0.2, 0.4
"""Damping times the time until commands arrive, on average over the motors, at most; the gains of agents with late
motors are lowered to it. Motors that are not late make up for others, as far as they can. Where energy is pumped, the
second number holds: the target is passed with speed, which motors brake while they outweigh gravity, or never."""
GRACE, FADING = 0.2, 0.1
"""Seconds without a trusted image that the estimate runs on the model, and in which the action then fades to zero."""


class Belief(NamedTuple):
    """What the agent knows after an image.

    Attributes:
        estimate: positions and velocities.
        action: `[m]` the action it chose.
        pump: memory of energy pumping.
        energy: learned T + V, in units of total mass 1 x (image units / s)^2.
        trust: what is thought of the images.
        swinging: whether the mechanism swings about its target, and how far images are believed.
    """

    estimate: Estimate
    action: Array
    pump: PumpState
    energy: Array
    trust: Trust
    swinging: Swinging


class EnergyShapingAgent:
    """Brings a mechanism to the configuration of a target image, from images alone.

    Every call of `act` finds the keypoints in the image, corrects the state that the learned dynamics predicted, and
    applies the control law. Where an actuator is too weak to lift the mechanism, which the learned model tells, energy
    is pumped first.

    An image is trusted if it shows the mechanism (see `keycld_control.plausibility`), agrees with the motion so far,
    and does not merely repeat the one before. Without trusted images the estimate runs on the model for 0.2 s; then
    the action fades to zero within 0.1 s. When images return, the agent begins anew, and acts once four of them agree.

    Where keypoints are read in steps near the target, the mechanism would swing about it; then images are believed
    less, and the motion is damped more (see `keycld_control.limit_cycle`).

    The camera may be off by a few pixels, and light and noise may be others than in training: how they differ is told
    from the target image, from the first image of every episode, and anew when the agent begins anew (see
    `keycld_model.camera`).

    Args:
        model: a `keycld_model.WorldModel`.
        target_img: `[H, W, 3]`, the mechanism at its target as the camera sees it; uint8, or float in 0..1.
        kp: stiffness, 1/s^2.
        kd: damping, 1/s. Where commands are late, both are lowered, with the same damping ratio.
        law: "turning" (every rod turns to its angle as a damped oscillator), "projected" (the paper's law on the
            constraint manifold), or "paper" (its formula to the letter); see `keycld_control.law`.
        action_space: the environment's action space. If neither this nor `action_limit` is given, actions stay within
            the default limits of the environment that the model was trained on.
        action_limit: symmetric limit of the actions instead, one number or `[m]`.

    Attributes:
        target: `[K, 2]` keypoints of the target image, image units.
        target_energy: learned V there, in units of total mass 1 x (image units / s)^2.
        pivot: `[2]` fixed pivot of the mechanism, image units.
        camera: how the camera differs from the model's, told from the target image, then from the first image of an
            episode; see `keycld_model.camera.Camera`.
        pumps: whether the actuators are too weak to lift the mechanism directly.

    Raises:
        InputError: if the target image has the wrong size, does not show the mechanism, or shows an impossible
            configuration; if gains or bounds are out of range; or if the mechanism has not as many independent
            actuators as degrees of freedom.
    """

    def __init__(
        self,
        model: LearnedModel,
        target_img: ArrayLike,
        kp: float = DEFAULT_KP,
        kd: float = DEFAULT_KD,
        *,
        law: Law = "turning",
        action_space: spaces.Space | None = None,
        action_limit: ArrayLike | None = None,
    ) -> None:
        if law not in LAWS:
            raise InputError(f"law must be one of {', '.join(map(repr, get_args(Law)))}, got {law!r}.")
        for name, gain in (("kp", kp), ("kd", kd)):
            if isinstance(gain, bool) or not isinstance(gain, Real) or not 0 < gain < np.inf:
                raise InputError(f"{name} must be a positive finite number, got {short(gain)}.")
        bounds = action_bounds(model.system, model.mechanism.num_actions, action_space, action_limit)
        if not model.constrained:
            raise InputError(
                "Energy shaping needs a model whose rods and sliders hold its masses, which this one's do not; train "
                'one with motion="constrained", for instance with --preset default.'
            )
        self._image_shape = model.image_shape
        plant = Plant.of(model)
        pixels = check_image("The target image", target_img, model.image_shape)
        known = expect(model, plant, roughly(model, plant, pixels))
        self._background, self._drawn = np.asarray(known.background), np.asarray(known.drawn)
        self.camera = self._target_camera = Camera.find(self._background, pixels) or Camera()
        self._restoration = self.camera.restoration(self._drawn)
        plain = restored(self._restoration, self._background, pixels)
        target = find_target(model, plain)
        plant = replace(plant, keypoint_noise=_keypoint_noise(model, plain, target))
        _check_actuation(plant, target)
        self._actuation = Actuation(model.added, *bounds)
        low, high = (jnp.asarray(bound, jnp.float32) for bound in (self._actuation.low, self._actuation.high))
        pump = None if law == "paper" else plan_pumping(plant, target, low, high)
        self.target: NDArray[np.float32] = np.asarray(target).reshape(-1, 2)
        self.target_energy = float(jax.jit(model.potential_energy_fn)(target))
        self.pivot: NDArray[np.float32] = np.asarray(model.pivot)
        self.pumps = pump is not None
        late = kd * plant.timestep * float(self._actuation.lead.mean())
        most = BRAKING if self.pumps else ROBUST
        slower = min(1.0, most / late) if late else 1.0
        self._first, self._next = _compile(
            plant, model.keypoints_fn, known, target, kp * slower**2, kd * slower, law, pump, self._actuation.lead
        )
        self._belief: Belief | None = None
        self._image: NDArray[Any] | None = None
        self._lost_after = _lost_after(plant)

    def act(self, obs: ArrayLike | Mapping[str, Any]) -> NDArray[np.float32]:
        """Choose the action for the next step.

        Args:
            obs: the image, `[H, W, 3]` uint8 or float in 0..1, or a mapping with the image under "pixels". One call
                per control step: the agent assumes that the action it returned before has been applied since.

        Returns:
            `[m]` action within the bounds; zero if images cannot be trusted any more, see `trusted`.

        Raises:
            InputError: if the image has the wrong shape or type, or is not finite, or the model's answer to it is not.
        """
        if isinstance(obs, Mapping):
            if "pixels" not in obs:
                raise InputError(f"The observation has no 'pixels', only {sorted(obs)}; use obs_type='pixels'.")
            obs = obs["pixels"]
        image = check_image("The observation", obs, self._image_shape)
        if self._belief is None or self._belief.trust.unseen >= self._lost_after:
            self.camera = Camera.find(self._background, image) or self._target_camera
            self._restoration = self.camera.restoration(self._drawn)
        outlook = Outlook(*(part.astype(np.float32) for part in self._actuation.outlook()))
        if self._belief is None:
            belief = self._first(image, self._restoration, outlook)
        else:
            repeated = self._image is not None and np.array_equal(self._image, image)
            belief = self._next(self._belief, image, repeated, self._restoration, outlook)
        action = np.asarray(belief.action)
        if not np.isfinite(action).all():
            raise InputError(
                "The model's answer to the image is not finite; its weights may be damaged, load another copy or train "
                "again."
            )
        self._belief, self._image = belief, np.array(image)
        return self._actuation.command(action).astype(np.float32)

    def reset(self) -> None:
        """Forget the past; call at the start of every episode."""
        self._belief = self._image = None
        self._actuation.reset()

    @property
    def trusted(self) -> bool:
        """Whether the last image showed the mechanism where it was expected, so that the action rests on it."""
        return bool(trusted(self._known.trust))

    @property
    def keypoints(self) -> NDArray[np.float32]:
        """`[K, 2]` estimated keypoints in the last image, image units."""
        return np.asarray(self._known.estimate.x).reshape(-1, 2)

    @property
    def velocities(self) -> NDArray[np.float32]:
        """`[K, 2]` estimated velocities of the keypoints, image units per second."""
        return np.asarray(self._known.estimate.v).reshape(-1, 2)

    @property
    def energy(self) -> float:
        """Learned energy T + V of the last estimate, in units of total mass 1 x (image units / s)^2."""
        return float(self._known.energy)

    @property
    def _known(self) -> Belief:
        if self._belief is None:
            raise InputError("The agent has seen no image since its reset; call act first.")
        return self._belief


def _check_actuation(plant: Plant, target: Array) -> None:
    """Refuse mechanisms that the laws cannot control."""
    freedom, size = plant.mechanism.degrees_of_freedom, plant.mechanism.num_actions
    gram = np.asarray(jax.jit(lambda x: responses(plant, x, jnp.zeros_like(x))[1].gram)(target), np.float64)
    scale = np.sqrt(np.outer(gram.diagonal(), gram.diagonal()))
    if size != freedom or not np.linalg.eigvalsh(gram / scale).min() > 1e-4:
        raise InputError(
            f"Energy shaping needs one independent actuator per degree of freedom, but the model has {size} "
            f"action(s) for {freedom} degree(s) of freedom; use a fully actuated system."
        )


def _fading(plant: Plant) -> int:
    """Images in which the action fades."""
    return max(1, round(FADING / plant.timestep))


def _keypoint_noise(model: LearnedModel, image: NDArray[Any], target: Array) -> float:
    """How far keypoints are off at the target, where they matter most: from the nearest possible configuration.

    Where parts hide each other there, this is many times what keypoints are off elsewhere. Within three standard
    deviations it is the usual noise.
    """
    found = jax.jit(model.keypoints_fn)(jnp.asarray(image)).ravel()
    off = float(jnp.max(jnp.abs(found - jnp.ravel(target))))
    return off if off > 3 * KEYPOINT_NOISE else KEYPOINT_NOISE


def _lost_after(plant: Plant) -> int:
    """Images in a row, not to be trusted, after which the agent begins anew."""
    return round(GRACE / plant.timestep) + _fading(plant)


def _compile(
    plant: Plant,
    see: Callable[[Array], Array],
    known: Plausibility,
    target: Array,
    kp: float,
    kd: float,
    law: Law,
    pump: Pump | None,
    lead: NDArray[np.intp],
) -> tuple[Callable[..., Belief], Callable[..., Belief]]:
    """The agent's two programs: for the first image of an episode, and for every further one."""
    fading, lost = _fading(plant), _lost_after(plant)

    def wanted(
        x: Array, v: Array, memory: PumpState, kp: Array, kd: Array, low: Array, high: Array
    ) -> tuple[Array, PumpState]:
        action = LAWS[law](plant, x, v, target, kp, kd, low, high)
        if pump is not None:
            memory, pumping = pumping_action(plant, pump, memory, x, v, target, kp, kd, low, high)
            action = jnp.where(memory.caught, action, pumping)
        return jnp.clip(action, low, high), memory

    # an agent that pumps passes its target again and again; gains for late motors are lowered as far as they may be
    watches = pump is None and not lead.any()
    ahead = _ahead(plant, lead, wanted)

    def decide(estimate: Estimate, memory: PumpState, trust: Trust, swinging: Swinging, outlook: Outlook) -> Belief:
        x, v = estimate.x, estimate.v
        action, memory = ahead(x, v, memory, *swinging.gains(kp, kd), outlook)
        weight = jnp.where(trust.beginning, 0.0, jnp.clip((lost - trust.unseen) / fading, 0.0, 1.0))
        action = jnp.where(weight > 0, weight * action, 0.0)
        return Belief(estimate, action, memory, energy(plant, x, v), trust, swinging)

    def first(image: ArrayLike, restoration: Restoration, outlook: Outlook) -> Belief:
        pixels = restore(restoration, known.background, jnp.asarray(image))
        keypoints = see(pixels)
        estimate = first_estimate(plant, keypoints)
        shown = shows_mechanism(plant, known, pixels, keypoints)
        trust = first_trust(estimate, jnp.where(shown, 0, lost))
        return decide(estimate, first_pump_state(), trust, no_swinging(), outlook)

    def following(
        belief: Belief, image: ArrayLike, repeated: ArrayLike, restoration: Restoration, outlook: Outlook
    ) -> Belief:
        pixels = restore(restoration, known.background, jnp.asarray(image))
        blind = belief.trust.unseen >= lost
        keypoints, applied = see(pixels), jnp.asarray(outlook.applied)
        shown = shows_mechanism(plant, known, pixels, keypoints)
        prior = choose(blind, belief.estimate, predicted(plant, belief.estimate, applied))
        again, noise = jnp.asarray(repeated), belief.swinging.noise(plant)
        estimate, trust = judged(plant, belief.trust, prior, applied, keypoints, shown, again, blind, noise)
        swinging = watched(plant, target, belief.swinging, estimate) if watches else belief.swinging
        return decide(estimate, belief.pump, trust, swinging, outlook)

    return jax.jit(first), jax.jit(following)


def _ahead(plant: Plant, lead: NDArray[np.intp], wanted: Callable[..., tuple[Array, PumpState]]) -> Callable[..., Any]:
    """The law `wanted` for motors that are late by `lead` frames: it is asked in the states that are expected then."""

    def ahead(x: Array, v: Array, memory: PumpState, kp: Array, kd: Array, outlook: Outlook) -> tuple[Array, PumpState]:
        """What motors shall do once the command arrives: the law's answer to the state that is expected then."""

        def frame(state: tuple[Array, Array, PumpState], then: tuple[Array, Array]) -> tuple[Any, Any]:
            (x, v, memory), (k, queued) = state, then
            low, high = (jnp.where(k < lead, queued, bound) for bound in (outlook.low, outlook.high))
            chosen, memory = wanted(x, v, memory, kp, kd, low, high)
            return (*project(plant, *advanced(plant, x, v, chosen)), memory), (chosen, memory)

        if not lead.any():
            return wanted(x, v, memory, kp, kd, jnp.asarray(outlook.low), jnp.asarray(outlook.high))
        queued = jnp.concatenate([outlook.queued, outlook.queued[-1:]])
        _, (chosen, memories) = jax.lax.scan(frame, (x, v, memory), (jnp.arange(len(queued)), queued))
        return chosen[lead, jnp.arange(len(lead))], jax.tree.map(lambda a: a[0], memories)

    return ahead
