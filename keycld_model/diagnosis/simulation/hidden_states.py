"""What motors and effects remember at the starts of windows, as far as the recordings before them tell."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects.places import ActuatorEffect, JointEffect
from keycld_envs.effects.transmission import TransmissionEffect
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.variant import Variant
from keycld_model.rigid_body.effects import AppliedEffects, memories

Array = NDArray[np.float64]


class MotorStates:
    """States of a model's own motors, which may remember earlier commands.

    Attributes:
        needed: there are motors that remember; such models are left to MuJoCo.
    """

    def __init__(self, model: mujoco.MjModel, size: int) -> None:
        """For states of MuJoCo of so many numbers."""
        self.needed = bool(model.na or np.any(model.actuator_delay))
        self._model, self._data, self._size = model, mujoco.MjData(model), size
        self._known: dict[int, tuple[Array, Array]] = {}

    def at(self, windows: Windows, commands: Sequence[Array]) -> Array:
        """States of MuJoCo `[W, size]` at the starts of windows, for commands `[N, nu]` of each recording.

        The first command has held for long before each recording.
        """
        out = np.zeros((len(windows), self._size))
        for r, u in enumerate(commands):
            mine = np.flatnonzero(windows.recording == r)
            if (known := self._known.get(id(u))) is None or known[0] is not u:
                known = u, self._along(u)
                if any(u is own for own in windows.commands):
                    self._known[id(u)] = known
            out[mine] = known[1][windows.first[mine]]
        return out

    def _along(self, u: Array) -> Array:
        """States `[N, size]` before each step of a recording."""
        model, data, states = self._model, self._data, np.empty((len(u), self._size))
        mujoco.mj_resetData(model, data)
        integrates = np.any(model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR)  # for ever, if the command held
        for k in [*[0] * (0 if integrates else 1000), *range(len(u))]:
            data.qpos[:], data.qvel[:], data.ctrl[:] = model.qpos0, 0.0, u[k]
            mujoco.mj_getState(model, data, states[k], mujoco.mjtState.mjSTATE_FULLPHYSICS)
            mujoco.mj_step(model, data)
        return states


def effects_that_push(
    model: mujoco.MjModel,
    variants: Sequence[Variant],
    models: Sequence[mujoco.MjModel],
    filtered: Sequence[Sequence[Array]],
    windows: Windows,
) -> list[AppliedEffects]:
    """Effects that push, and what they remember of the recordings before each window.

    Args:
        model: of the mechanism.
        variants: V of them.
        models: of the variants.
        filtered: of each variant, commands `[N, nu]` that reach the motors in each recording.
        windows: W windows.
    """
    pushing = [tuple(effect for effect in variant.effects if effect.forces) for variant in variants]
    out = [[np.zeros((len(windows), effect.memory)) for effect in some] for some in pushing]
    places: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for i, some in enumerate(pushing):
        for e, effect in enumerate(some):
            if effect.memory:
                places.setdefault(effect.key, []).append((i, e))
    for at in places.values():
        effects = [effect for i, e in at if isinstance(effect := pushing[i][e], JointEffect | ActuatorEffect)]
        path = _remembered(effects, [variants[i] for i, _ in at], [(models[i], filtered[i]) for i, _ in at], windows)
        for row, (i, e) in enumerate(at):
            offsets = variants[i].window_offsets_of(pushing[i][e], len(windows))
            out[i][e] = path[windows.first, row, windows.recording] + offsets
    return [AppliedEffects(some, tuple(memory)) for some, memory in zip(pushing, out, strict=True)]


def _remembered(
    effects: Sequence[JointEffect | ActuatorEffect],
    variants: Sequence[Variant],
    driven: Sequence[tuple[mujoco.MjModel, Sequence[Array]]],
    windows: Windows,
) -> Array:
    """What effects of one kind at one place remember along recordings, `[T + 1, V, R, memory]`.

    Args:
        effects: one of each of V variants.
        variants: that they belong to.
        driven: model of each variant, and commands that reach its motors.
        windows: of the recordings.
    """
    recordings, longest = len(windows.commands), max(map(len, windows.commands))
    speeds = np.stack([_padded(v, longest) for v in windows.speeds], axis=1)  # [T, R, nv]
    motor = np.zeros((longest, len(effects), recordings))
    for row, (effect, (model, commands)) in enumerate(zip(effects, driven, strict=True)):
        if isinstance(effect, TransmissionEffect):
            torques = [effect.torque_of(model, u) for u in commands]
            motor[:, row] = np.stack([_padded(torque, longest) for torque in torques], axis=1)
    pairs = zip(effects, variants, strict=True)
    starts = np.stack([variant.recording_offsets_of(effect, recordings) for effect, variant in pairs])
    return memories(effects, motor, speeds[..., effects[0].dof(driven[0][0])], starts, windows.step)


def _padded(values: Array, length: int) -> Array:
    """Values with the last row repeated to a length."""
    return np.concatenate([values, np.repeat(values[-1:], length - len(values), axis=0)])
