"""`EnergyShapingAgent`: from one image per step to an action, with a world model and one target image."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jax import Array
from numpy.typing import ArrayLike, NDArray

from keycld_control.law import LAWS, Law
from keycld_control.limits import action_bounds
from keycld_control.observer import Estimate, first_estimate, next_estimate
from keycld_control.plant import LearnedModel, Plant, energy, responses
from keycld_control.pumping import Pump, PumpState, first_pump_state, plan_pumping, pumping_action
from keycld_control.targets import check_image, find_target
from keycld_envs.errors import InputError

DEFAULT_KP, DEFAULT_KD = 40.0, 10.0


class Belief(NamedTuple):
    """What the agent knows after an image.

    Attributes:
        estimate: positions and velocities.
        action: `[m]` the action it chose.
        pump: memory of energy pumping.
        energy: learned T + V, in units of total mass 1 x (image units / s)^2.
    """

    estimate: Estimate
    action: Array
    pump: PumpState
    energy: Array


class EnergyShapingAgent:
    """Brings a mechanism to the configuration of a target image, from images alone.

    Every call of `act` finds the keypoints in the image, corrects the state that the learned dynamics predicted, and
    applies the control law. Where an actuator is too weak to lift the mechanism, which the learned model tells, energy
    is pumped first.

    Args:
        model: a `keycld_model.WorldModel`.
        target_img: `[H, W, 3]`, the mechanism at its target as the camera sees it; uint8, or float in 0..1.
        kp: stiffness, 1/s^2.
        kd: damping, 1/s.
        law: "turning" (every rod turns to its angle as a damped oscillator), "projected" (the paper's law on the
            constraint manifold), or "paper" (its formula to the letter); see `keycld_control.law`.
        action_space: the environment's action space. If neither this nor `action_limit` is given, actions stay within
            the default limits of the environment that the model was trained on.
        action_limit: symmetric limit of the actions instead, one number or `[m]`.

    Attributes:
        target: `[K, 2]` keypoints of the target image, image units.
        target_energy: learned V there, in units of total mass 1 x (image units / s)^2.
        pivot: `[2]` fixed pivot of the mechanism, image units.
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
            if not 0 < gain < np.inf:
                raise InputError(f"{name} must be a positive finite number, got {gain!r}.")
        bounds = action_bounds(model.system, model.mechanism.num_actions, action_space, action_limit)
        low, high = jnp.asarray(bounds[0]), jnp.asarray(bounds[1])
        self._image_shape = model.image_shape
        target = find_target(model, target_img)
        plant = Plant.of(model)
        _check_actuation(plant, target)
        pump = None if law == "paper" else plan_pumping(plant, target, low, high)
        self.target: NDArray[np.float32] = np.asarray(target).reshape(-1, 2)
        self.target_energy = float(jax.jit(model.potential_energy_fn)(target))
        self.pivot: NDArray[np.float32] = np.asarray(model.pivot)
        self.pumps = pump is not None
        self._first, self._next = _compile(
            plant, model.keypoints_fn, target, float(kp), float(kd), law, pump, low, high
        )
        self._belief: Belief | None = None

    def act(self, obs: ArrayLike | Mapping[str, Any]) -> NDArray[np.float32]:
        """Choose the action for the next step.

        Args:
            obs: the image, `[H, W, 3]` uint8 or float in 0..1, or a mapping with the image under "pixels". One call
                per control step: the agent assumes that the action it returned before has been applied since.

        Returns:
            `[m]` action within the bounds.

        Raises:
            InputError: if the image has the wrong shape or type, or is not finite.
        """
        if isinstance(obs, Mapping):
            if "pixels" not in obs:
                raise InputError(f"The observation has no 'pixels', only {sorted(obs)}; use obs_type='pixels'.")
            obs = obs["pixels"]
        image = check_image("The observation", obs, self._image_shape)
        self._belief = self._first(image) if self._belief is None else self._next(self._belief, image)
        return np.asarray(self._belief.action)

    def reset(self) -> None:
        """Forget the past; call at the start of every episode."""
        self._belief = None

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


def _compile(
    plant: Plant,
    see: Callable[[Array], Array],
    target: Array,
    kp: float,
    kd: float,
    law: Law,
    pump: Pump | None,
    low: Array,
    high: Array,
) -> tuple[Callable[[ArrayLike], Belief], Callable[[Belief, ArrayLike], Belief]]:
    """The agent's two programs: for the first image of an episode, and for every further one."""

    def decide(estimate: Estimate, memory: PumpState) -> Belief:
        x, v = estimate.x, estimate.v
        action = LAWS[law](plant, x, v, target, kp, kd, low, high)
        if pump is not None:
            memory, pumping = pumping_action(plant, pump, memory, x, v, target, kp, kd, low, high)
            action = jnp.where(memory.caught, action, pumping)
        action = jnp.clip(jnp.nan_to_num(action), low, high)
        return Belief(estimate, action, memory, energy(plant, x, v))

    def first(image: ArrayLike) -> Belief:
        return decide(first_estimate(plant, see(jnp.asarray(image))), first_pump_state())

    def following(belief: Belief, image: ArrayLike) -> Belief:
        keypoints = see(jnp.asarray(image))
        return decide(next_estimate(plant, belief.estimate, belief.action, keypoints), belief.pump)

    return jax.jit(first), jax.jit(following)
