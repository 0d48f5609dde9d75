"""Backlash and flexible shafts: how well they fit has many optima, so that many starts are tried."""

from collections.abc import Sequence

from keycld_envs.effects import Effect
from keycld_envs.effects.transmission import TransmissionEffect
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.point import Point
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.search.effort import EFFORT
from keycld_model.diagnosis.search.hypotheses import Hypothesis


def promising_transmissions(
    fit: Fit, rest: Sequence[Effect], effect: TransmissionEffect, hypotheses: Sequence[Hypothesis]
) -> list[tuple[Effect, ...]]:
    """Sets with a transmission in the place of another, the best of many starts.

    Args:
        fit: on some of the windows.
        rest: the other effects of the set.
        effect: the transmission.
        hypotheses: all that may be missing.
    """
    model = fit.problem.simulator.model
    kinds = {type(h.effect) for h in hypotheses if isinstance(h.effect, TransmissionEffect)}
    inertia = float(model.dof_M0[effect.dof(model)])
    used, ordered = {e.key for e in rest}, sorted(kinds, key=lambda k: k.id)
    starts = [s for kind in ordered for s in kind.starts(effect.where, inertia) if s.key not in used]
    ways = (False, True) if fit.chi_square > fit.problem.criteria.noise_variance else (False,)
    glances = [_glance(fit, [*rest, start], free) for start in starts for free in ways]
    chosen = sorted(glances, key=_cost)[: EFFORT.rotor_starts]
    closer = [minimise(fit.problem, glance.point, 10) for glance in chosen]
    return [glance.effects for glance in sorted(closer, key=_cost)[: EFFORT.finalists]]


def with_free_rotors(problem: Problem, point: Point) -> Point:
    """With rotors that may be anywhere at the starts of windows, and initial states fitted to that."""
    return minimise(problem, point.with_free_rotors(), 6, only_states=True).point


def _glance(fit: Fit, effects: Sequence[Effect], free: bool) -> Fit:
    """A few steps with other effects; with rotors that may be anywhere if `free`."""
    point = fit.point.with_offsets(None).with_effects(*effects)
    return minimise(fit.problem, with_free_rotors(fit.problem, point) if free else point, 3)


def _cost(fit: Fit) -> float:
    return fit.cost
