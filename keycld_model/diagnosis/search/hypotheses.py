"""What may be missing, and how each of it would change what a fit leaves, to first order."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs.effects import EFFECTS, Effect, Parameter
from keycld_envs.effects.base import Seen
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.linearisation import Linearisation
from keycld_model.diagnosis.estimation.push_responses import push_responses
from keycld_model.diagnosis.inputs.windows import Windows
from keycld_model.diagnosis.simulation.places import places_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a place, with its nonlinear parameters at one value of their grids.

    Attributes:
        effect: absent: its coefficients are zero.
        coefficients: in which it is linear; empty if it is there or not.
    """

    effect: Effect
    coefficients: tuple[Parameter, ...]

    @property
    def key(self) -> tuple[str, str]:
        """What it is and where."""
        return self.effect.key

    @property
    def pushes(self) -> bool:
        """The effect is a force on the joints and nothing else."""
        kind = type(self.effect)
        elsewhere = (kind.edit, kind.command, kind.observe) != (Effect.edit, Effect.command, Effect.observe)
        return self.effect.forces and not elsewhere

    def numbers(self, sizes: Iterable[float]) -> dict[str, float]:
        """Its coefficients by name, this far from where the effect is absent."""
        return {p.name: float(p.absent + size) for p, size in zip(self.coefficients, sizes, strict=False)}

    def of_all_parameters(self, values: Iterable[float]) -> Array:
        """Values of its coefficients at their places among all parameters of the effect; zeros for the others."""
        own = dict(zip(self.coefficients, values, strict=False))
        return np.array([own.get(p, 0.0) for p in self.effect.parameters()])

    def probes(self, amount: float = 1.0) -> list[Effect]:
        """The effect a little present, once per coefficient; `amount` of the usual."""
        if not self.coefficients:
            return [self.effect]
        return [replace(self.effect, **{p.name: p.absent + amount * p.scale}) for p in self.coefficients]


def recorded_range(windows: Windows) -> Seen:
    """Positions, speeds and commands that windows of recordings show."""
    position = windows.observation.positions(windows.measured.reshape(-1, windows.measured.shape[2]))
    speed, command = np.concatenate(windows.speeds), np.concatenate(windows.commands)
    usual = np.percentile(np.abs(speed), 90, axis=0)
    return Seen(np.nanmin(position, axis=0), np.nanmax(position, axis=0), usual, np.abs(command).max(axis=0, initial=0))


def hypotheses(model: mujoco.MjModel, shown: Seen, exclude: Iterable[str] = ()) -> list[Hypothesis]:
    """All effects at all places of a model, with numbers that recordings suggest."""
    out = []
    for kind in EFFECTS.values():
        if kind.id in exclude or not kind.searched:
            continue
        coefficients = tuple(p for p in kind.parameters() if not p.grid)
        for effect in places_of(kind, model):
            grids = effect.grids(model, shown)
            for values in itertools.product(*grids.values()):
                out.append(Hypothesis(effect.with_parameters(**dict(zip(grids, values, strict=True))), coefficients))
    return out


def columns(fit: Fit, free: Sequence[Hypothesis]) -> tuple[Linearisation, Array, list[list[int]]]:
    """How residuals would fall with each number of each hypothesis.

    An effect that is a force on the joints counts by what its force along the fitted motion would do, so that any
    number of them costs no more simulations than a push at every joint in every part of a window; others are simulated.

    Returns:
        Linearisation of the fit itself, columns `[W, r, C]` per unit of a number, and of each hypothesis its columns.
    """
    probes = [(h, j, probe) for h, hypothesis in enumerate(free) for j, probe in enumerate(hypothesis.probes())]
    simulated = [c for c, (h, _, _) in enumerate(probes) if not free[h].pushes]
    linear, moved = _simulated(fit, free, [probes[c] for c in simulated])
    out = np.zeros((*linear.residual.shape, len(probes)))
    out[..., simulated] = moved
    pushing = [c for c, (h, _, _) in enumerate(probes) if free[h].pushes]
    if pushing:
        parts = min(16, fit.problem.windows.steps)  # over each of which a force is averaged
        responses = push_responses(fit.problem, fit.point, range(fit.point.q.shape[1]), parts)
        forces = _forces(fit, [probes[c][2] for c in pushing], parts)
        out[..., pushing] = np.einsum("wrjb,cwbj->wrc", responses, forces, optimize=True)
    for c, (h, j, _) in enumerate(probes):
        out[..., c] /= free[h].coefficients[j].scale if free[h].coefficients else 1.0
    members = [[c for c, (i, _, _) in enumerate(probes) if i == h] for h in range(len(free))]
    return linear, out, members


def _simulated(
    fit: Fit, free: Sequence[Hypothesis], probes: list[tuple[int, int, Effect]]
) -> tuple[Linearisation, Array]:
    """Columns per probe, from rollouts with so little of each effect that it is nearly linear."""
    linear, residuals = fit.problem.linearise(fit.point, [(*fit.effects, probe) for *_, probe in probes])
    inverse_noise = fit.problem.inverse_noise.reshape(linear.residual.shape)
    moved = np.max(np.sqrt(np.mean(((residuals - linear.residual) / inverse_noise) ** 2, axis=2)), axis=1)
    nearly_linear = 0.03  # change of a channel, root mean square over a window, rad or m
    amounts = np.clip(nearly_linear / np.maximum(moved, 1e-12), 1e-4, 1.0)
    again = [c for c, (h, _, _) in enumerate(probes) if amounts[c] < 1 and free[h].coefficients]
    if again:
        gentler = [free[probes[c][0]].probes(amounts[c])[probes[c][1]] for c in again]
        residuals[again] = fit.problem.linearise(fit.point, [(*fit.effects, probe) for probe in gentler])[1]
    used = np.array([amounts[c] if c in set(again) else 1.0 for c in range(len(probes))])
    return linear, np.moveaxis((linear.residual - residuals) / used[:, None, None], 0, -1)


def _forces(fit: Fit, effects: Sequence[Effect], parts: int) -> Array:
    """What effects would exert along the fitted motion, averaged over parts of windows, `[C, W, B, nv]`."""
    windows, simulator, point = fit.problem.windows, fit.problem.simulator, fit.point
    model, h = simulator.compile(point.variant), simulator.step
    q, v, u = fit.problem.path(point)
    middle_q = (q[:, 1:] + q[:, :-1]) / 2 - h / 8 * np.diff(v, axis=1)
    middle_v = 1.5 * np.diff(q, axis=1) / h - (v[:, 1:] + v[:, :-1]) / 4
    time = windows.begun[:, None] + (np.arange(windows.steps) + 0.5) * h
    edges = windows.edges(parts)
    out = np.zeros((len(effects), len(windows), parts, point.q.shape[1]))
    for row, effect in zip(out, effects, strict=True):
        if effect.memory:
            memory, force = effect.begin(model, v[:, 0]), np.empty_like(middle_v)
            for k in range(windows.steps):
                now = time[:, k], middle_q[:, k], middle_v[:, k], u[:, k]
                force[:, k], memory = effect.advance(model, memory, *now, h)
        else:
            force = effect.force(model, time, middle_q, middle_v, u)
        row[:] = np.add.reduceat(np.nan_to_num(force), edges[:-1], axis=1) / np.diff(edges)[:, None]
    return out
