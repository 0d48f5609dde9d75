"""Effects in a simulation that goes step by step."""

from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial
from numbers import Real
from typing import cast

import mujoco
import numpy as np

from keycld_envs.checks import short
from keycld_envs.constants import update_constants
from keycld_envs.effects.base import Array, Effect
from keycld_envs.effects.edited import actuator_torque
from keycld_envs.effects.load_dependent_friction import bearing_force
from keycld_envs.effects.places import add_friction
from keycld_envs.errors import InputError

MEMORY = 500
"""Control steps that lags and delays remember."""


class AddedPhysics:
    """Effects, in a model that they change, with the commands of the past.

    Raises:
        InputError: if an effect is in the measurement, at a place that the model does not have, or has a number that
            physics does not allow.
    """

    def __init__(self, effects: Sequence[Effect], model: mujoco.MjModel) -> None:
        self.effects, self.model = tuple(effects), model
        self._past: deque[Array] = deque(maxlen=MEMORY)
        self._memory: list[Array] = []
        for effect in self.effects:
            if not isinstance(effect, Effect):
                raise InputError(f"effects has {short(effect)}; it must hold effects of keycld_envs.effects.")
            if effect.observes:
                raise InputError(f"{effect.id} is in the measurement; an environment has only effects in the motion.")
            check_numbers(effect)
            known = {c.where for c in effect.candidates(model)}
            if not isinstance(effect.where, str) or effect.where not in known:
                raise InputError(f"{effect.id} is at {short(effect.where)}; the model has {sorted(known)}.")
            effect.edit(model)
            if effect.has_dry_friction:
                add_friction(model, effect.slot(model)[0], 0.0)  # lets the model have some
        update_constants(model)
        self._friction = model.dof_frictionloss.copy()

    def reset(self) -> None:
        """Forget the past, in which no command was given."""
        self._past.clear()
        self._past.append(np.zeros(self.model.nu))
        self._memory = [effect.begin(self.model, np.zeros(self.model.nv)) for effect in self.effects]

    def steps(self, data: mujoco.MjData, number: int) -> Iterator[int]:
        """Before each of the next steps, set what motors get for the controls now set, and the forces."""
        self._past.append(data.ctrl.copy())
        h = float(self.model.opt.timestep)
        u = np.repeat(np.array(self._past), number, axis=0)
        for effect in self.effects:
            u = effect.command(self.model, u, h)
        for step in range(number):
            data.ctrl[:] = command = u[step - number]
            time, q, v = np.array(data.time), data.qpos.copy(), data.qvel.copy()
            data.qfrc_applied[:] = 0
            self.model.dof_frictionloss[:] = self._friction
            for i, effect in enumerate(self.effects):
                if effect.has_dry_friction:
                    self._set_friction(effect, q, v, command)
                    continue
                force, self._memory[i] = effect.advance(self.model, self._memory[i], time, q, v, command, h)
                data.qfrc_applied[:] += force
            yield step

    def _set_friction(self, effect: Effect, q: Array, v: Array, u: Array) -> None:
        """Set dry friction for the next step; there is none below zero."""
        (dof, motor), friction = effect.slot(self.model), self.model.dof_frictionloss
        load = partial(bearing_force, self.model, effect.where, q, v, u)
        if motor >= 0:
            load = partial(actuator_torque, self.model, motor, q[dof], v[dof], u)
        more = effect.dry_friction(q[dof], v[dof], load)
        friction[dof] = max(0.0, friction[dof] + (0.0 if more is None else float(more)))


def check_numbers(effect: Effect) -> None:
    """Raise InputError if a number of an effect is not finite or outside its bounds."""
    for p in effect.parameters():
        value = getattr(effect, p.name)
        if isinstance(value, bool) or not isinstance(value, Real) or not abs(cast(float, value)) <= 1e300:
            raise InputError(
                f"{effect.id} at {short(effect.where)} has {p.name}={short(value)}; it must be a finite number."
            )
        if not p.low <= cast(float, value) <= p.high and value != p.absent:
            bounds = f"{p.low:g} or more" if p.high == np.inf else f"between {p.low:g} and {p.high:g}"
            raise InputError(f"{effect.id} at {effect.where!r} has {p.name}={value:g} {p.unit}; it must be {bounds}.")
