"""`JointAgent`: from joint positions to an action, with a joint model and a target pose.

The law is that of computed torques: say which acceleration is wanted, and choose the action within its bounds whose
acceleration M^-1 (B u - h) is nearest to it in the metric of M (Gauss' principle; Bruyninckx and Khatib, 2000). B is
the torque of one unit of each action, h what motion and weight and friction need. Where a motor is too weak to hold its
joint somewhere between the target and hanging down, energy is pumped first: that joint is pushed in the direction of
its motion until the model's energy is a little above the highest on the way, while the others stay at their targets.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import lsq_linear

from keycld_control.limits import action_bounds
from keycld_envs.checks import check_number
from keycld_envs.errors import InputError
from keycld_model.delan.model import JointModel

Floats = NDArray[np.float64]
DEFAULT_KP, DEFAULT_KD = 40.0, 10.0
FASTEST = 4.0
"""Joints are not sent to their target faster than this, rad/s or m/s."""
POSES = 512
MARGIN, RELEASE = 0.95, 1.2
"""A motor lifts directly if weight asks for at most the first share of its limit; what was caught is let go beyond the
second."""
EXCESS, BAND = 0.02, 0.05
"""Energy wanted beyond the highest on the way, and below which pumping weakens, as shares of the range of V on it."""
SLOW = 0.02
"""Speed under which a pumped joint keeps the direction it is pushed in, rad/s or m/s."""
CORRECTED = 0.5
"""Share by which a measured position corrects the predicted velocity."""


@dataclass(frozen=True)
class PumpPlan:
    """How energy is gathered.

    Attributes:
        joint: that is pushed.
        energy: wanted, J.
        span: range of the potential energy as it turns, J.
    """

    joint: int
    energy: float
    span: float


class JointAgent:
    """Brings joints to a target, from their positions, by learned equations of motion.

    Args:
        model: of joints that all have a motor; `keycld delan train` makes one.
        target: `[n]` positions, rad or m; hinges take the shorter way.
        torque: of one unit of each action, one number or `[n]`, N m or N, in the order of the model's joints.
        action_space: the environment's action space.
        action_limit: symmetric limit of the actions instead, one number or `[n]`.
        kp: stiffness, 1/s^2.
        kd: damping, 1/s.
        timestep: seconds between two calls of `act`; needed where velocities are not measured.

    Attributes:
        pump: the plan of gathering energy; None if motors lift their joints directly.

    Raises:
        InputError: if the model is a feed-forward network, the target has another shape, an action has no torque, or
            gains or bounds are out of range.
    """

    def __init__(
        self,
        model: JointModel,
        target: ArrayLike,
        torque: ArrayLike = 1.0,
        *,
        action_space: spaces.Space | None = None,
        action_limit: ArrayLike | None = None,
        kp: float = DEFAULT_KP,
        kd: float = DEFAULT_KD,
        timestep: float | None = None,
    ) -> None:
        n = model.config.n
        model.potential_energy(np.zeros(n))  # refuses networks that have none
        for name, gain in (("kp", kp), ("kd", kd)):
            check_number(name, gain, 1e-9, 1e9)
        if timestep is not None:
            check_number("timestep", timestep, 1e-9, 1e3)
        self.target, self._torque = _sized("target", target, n), _sized("torque", torque, n)
        if not np.all(self._torque):
            raise InputError(f"torque is {self._torque.tolist()}; this law needs a motor at every joint.")
        low, high = action_bounds(None, n, action_space, action_limit)
        self._low, self._high = low.astype(np.float64), high.astype(np.float64)
        self._model, self._kp, self._kd, self._timestep = model, float(kp), float(kd), timestep
        self._hinges = np.array([kind == "hinge" for kind in model.config.kinds])
        self.pump = self._plan()
        self.reset()

    def reset(self) -> None:
        """Forget the past; call at the start of every episode."""
        self._caught, self._direction = False, 1.0
        self._expected: tuple[Floats, Floats] | None = None

    def act(self, q: ArrayLike, v: ArrayLike | None = None) -> NDArray[np.float32]:
        """Choose the action for the next step.

        Args:
            q: `[n]` positions, rad or m.
            v: `[n]` velocities, per s; without them, the model follows them from step to step, corrected by positions.

        Returns:
            `[n]` action within the bounds.

        Raises:
            InputError: if shapes are others, numbers are not finite, or there are neither velocities nor a timestep.
        """
        n = self._model.config.n
        q = _sized("q", q, n)
        v = self._followed(q) if v is None else _sized("v", v, n)
        action = self._action(q, v)
        if self._timestep is not None:
            tau = np.tile(self._torque * action, (2, 1))
            path, speed = self._model.rollout(q, v, tau, self._timestep, substeps=2)
            self._expected = path[1], speed[1]
        return action.astype(np.float32)

    def _followed(self, q: Floats) -> Floats:
        """Velocities by the model, at rest at first."""
        if self._timestep is None:
            raise InputError("v is missing; hand in velocities, or the timestep to JointAgent.")
        if self._expected is None or not np.isfinite(self._expected).all():
            return np.zeros_like(q)
        position, speed = self._expected
        return speed + CORRECTED * self._apart(q, position) / self._timestep

    def _action(self, q: Floats, v: Floats) -> Floats:
        wanted = self._wanted(q, v, self.target)
        mass, bias = self._model.mass_matrix(q), self._model.inverse_dynamics(q, v, np.zeros_like(q))
        if self.pump is None:
            return self._nearest(mass, bias, wanted)
        held, direct = (self._share(x) for x in (self._weight(q), mass @ wanted + bias))
        self._caught = bool(held.max() <= RELEASE if self._caught else direct.max() <= 1.0)
        return self._nearest(mass, bias, wanted) if self._caught else self._pumping(q, v, mass, bias)

    def _pumping(self, q: Floats, v: Floats, mass: Floats, bias: Floats) -> Floats:
        """Push one joint along its motion; the others accelerate towards their targets as well as they can."""
        assert self.pump is not None
        j, low, high = self.pump.joint, self._low.copy(), self._high.copy()
        if abs(v[j]) > SLOW:
            self._direction = float(np.sign(v[j]))
        lacking = self.pump.energy - float(self._model.energy(q, v))
        push = np.clip(lacking / (BAND * self.pump.span), -1.0, 1.0) * self._direction * np.sign(self._torque[j])
        own = push * (high[j] if push > 0 else -low[j])
        others = np.arange(len(q)) != j
        action = np.full(len(q), own)
        if others.any():
            inverse = np.linalg.inv(mass)
            free = inverse @ (self._torque * np.where(others, 0.0, own) - bias)
            matrix = (inverse * self._torque)[np.ix_(others, others)]
            missing = (self._wanted(q, v, self.target) - free)[others]
            action[others] = _bounded(matrix, missing, low[others], high[others])
        return action

    def _nearest(self, mass: Floats, bias: Floats, wanted: Floats) -> Floats:
        """The action whose acceleration is nearest to the wanted one, in the metric of the mass matrix."""
        inverse = np.linalg.inv(np.linalg.cholesky(mass))
        return _bounded(inverse * self._torque, inverse @ (mass @ wanted + bias), self._low, self._high)

    def _wanted(self, q: Floats, v: Floats, target: Floats) -> Floats:
        """Acceleration of a damped oscillator about the target, which it approaches no faster than `FASTEST`."""
        speed = -self._kp / self._kd * self._apart(q, target)
        speed *= min(1.0, FASTEST / max(float(np.abs(speed).max()), 1e-9))
        return self._kd * (speed - v)

    def _apart(self, q: Floats, other: Floats) -> Floats:
        """Positions less others; of hinges within half a turn."""
        difference = q - other
        return np.where(self._hinges, np.mod(difference + np.pi, 2 * np.pi) - np.pi, difference)

    def _weight(self, q: Floats) -> Floats:
        """Torques that hold positions `[..., n]`."""
        return self._model.inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q))

    def _share(self, torque: Floats) -> Floats:
        """Of its limit that each motor needs for torques `[..., n]`."""
        action = torque / self._torque
        return np.maximum(action / self._high, action / self._low)

    def _plan(self) -> PumpPlan | None:
        """Pump with the motor that lacks most to hold its joint, if any does."""
        turned = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, len(self.target)))
        poses = np.where(self._hinges, self.target + turned, self.target)
        share = self._share(self._weight(poses)).max(axis=0)
        if (share <= MARGIN).all():
            return None
        j = int(share.argmax())
        if not self._hinges[j]:
            raise InputError(
                f"The motor of {self._model.config.joints[j]!r}, which slides, cannot hold it; raise its limit."
            )
        way = np.tile(self.target, (POSES, 1))
        way[:, j] += np.linspace(-np.pi, np.pi, POSES)
        potential = self._model.potential_energy(way)
        span = float(np.ptp(potential))
        return PumpPlan(j, float(potential.max()) + EXCESS * span, span)


def _bounded(matrix: Floats, target: Floats, low: Floats, high: Floats) -> Floats:
    """Least squares within bounds."""
    free = np.linalg.lstsq(matrix, target, rcond=None)[0]
    inside = ((free >= low) & (free <= high)).all()
    return np.asarray(free if inside else lsq_linear(matrix, target, (low, high)).x, np.float64)


def _sized(name: str, value: ArrayLike | Sequence[float], n: int) -> Floats:
    array = np.asarray(value, np.float64)
    if array.shape not in ((n,), ()) or (array.shape == () and name in ("q", "v", "target") and n != 1):
        raise InputError(f"{name} has shape {list(array.shape)}; the model has {n} joint(s), so that it needs [{n}].")
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds NaN or infinity; every number must be finite.")
    return np.broadcast_to(array, (n,)).copy()
