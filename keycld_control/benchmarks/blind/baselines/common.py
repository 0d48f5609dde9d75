"""What all baselines share: the refitted simulator, the errors on held-out recordings, and the report."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from keycld_control.benchmarks import refitting
from keycld_control.benchmarks.refitting import HORIZON, SAMPLES, Fit, JointPositions, Problem, Simulator, Variant
from keycld_envs.effects import Effect
from keycld_envs.recordings import Recording

EXPLAINED = 1.3
"""Mean square of whitened residuals up to which a baseline takes what is left for noise."""


@dataclass(frozen=True)
class Setup:
    """Recordings of one case as the diagnosis uses them, and the simulator with Runge-Kutta steps.

    Attributes:
        training: no faster than the diagnosis reads.
        held_out: to test on.
        model: the simulator as it is believed to be.
    """

    training: Sequence[Recording]
    held_out: Sequence[Recording]
    model: mujoco.MjModel

    @classmethod
    def of(cls, training: Sequence[Recording], held_out: Sequence[Recording], model: mujoco.MjModel) -> "Setup":
        """The setup of checked recordings, of which no more samples are kept than the diagnosis uses."""
        refitting.check([*training, *held_out], model)
        refitting.check_apart(training, held_out)
        return cls([refitting.thin(r) for r in training], [refitting.thin(r) for r in held_out], model)

    @cached_property
    def spacing(self) -> float:
        """Seconds between samples."""
        return refitting.spacing(self.training)

    @cached_property
    def simulator(self) -> Simulator:
        """The simulator with steps such that samples are a whole number of them apart."""
        return Simulator(self.model, refitting.accurate_step(self.training), threads=1)

    @cached_property
    def observation(self) -> JointPositions:
        """Joint positions, with the noise of their sensors."""
        return JointPositions(self.model).calibrated(self.training)

    @cached_property
    def refitted(self) -> Fit:
        """The simulator with masses, lengths and zeros refitted, on the windows of the diagnosis."""
        problem = refitting.windowed(self.simulator, self.training, self.observation)
        return refitting.refit(refitting.at_most(problem))

    @cached_property
    def long(self) -> Problem:
        """Rollouts of held-out recordings, as long as those of the diagnosis."""
        shortest = min(len(np.asarray(r.t_state)) for r in self.held_out)
        samples = SAMPLES * max(1, min(HORIZON, shortest // SAMPLES))
        return refitting.windowed(self.simulator, self.held_out, self.observation, samples)

    def error(self, variant: Variant) -> float:
        """Root mean square of held-out rollouts with fitted initial states, mrad or mm."""
        fit = refitting.refit_states(self.long, variant, 12)
        return float(1e3 * np.sqrt(np.mean((fit.residual * self.observation.noise) ** 2)))

    def report(
        self, verdict: str, findings: list[dict[str, Any]], corrected: Variant, chi_square: float
    ) -> dict[str, Any]:
        """A report in the schema of the diagnosis, as far as a baseline can fill it."""
        nominal = Variant(np.zeros_like(self.refitted.problem.spreads))
        return {
            "schema": "keycld.diagnosis/1",
            "verdict": verdict,
            "findings": findings,
            "unexplained": {"significant": chi_square > EXPLAINED},
            "fit": {
                "unit": "mrad or mm",
                "nominal": self.error(nominal),
                "refitted": self.error(self.refitted.point.variant),
                "corrected": self.error(corrected),
            },
            "details": {"chi_square": {"refitted": self.refitted.chi_square, "corrected": chi_square}},
        }


def finding(effect: str, family: str, kind: str, name: str, parameters: dict[str, Any]) -> dict[str, Any]:
    """One effect that a baseline names; it knows no rivals."""
    where = {"kind": kind, "name": name}
    return {"effect": effect, "family": family, "where": where, "parameters": parameters, "rivals": []}


def with_effects(variant: Variant, *effects: Effect) -> Variant:
    """A refitted simulator with more physics."""
    return Variant(variant.values, effects)
