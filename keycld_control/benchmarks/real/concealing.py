"""Draws a comparison: which runs of a rig are a baseline, which are new, and what is concealed in these."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from keycld_control.benchmarks.real.gate import Runs
from keycld_envs.conceal import conceal
from keycld_envs.effects import EFFECTS, Effect
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording

SHAPES: Mapping[str, Mapping[str, float]] = {
    "viscous_friction": {"b": 0.02},
    "coulomb_friction": {"c": 0.1},
    "quadratic_drag": {"d": 0.005},
    "stribeck_friction": {"c": 0.05, "extra": 0.1, "vs": 1.0},
    "asymmetric_friction": {"forward": 0.1, "backward": 0.2},
    "constant_force": {"f": 0.1},
    "spring": {"k": 0.1, "f": 0.0},
    "cogging": {"a": 0.1, "b": 0.1},
    "external_periodic": {"a": 0.1, "b": 0.0},
    "actuator_gain": {"k": 1.1},
    "actuator_dead_zone": {"delta": 0.1},
    "actuator_delay": {"d": 0.01},
}
"""What is concealed, before it is made as large as it must be."""
FIXED = ("vs", "n", "w")
"""Parameters that are drawn, or stay as they are, whatever the size."""
MOST = {"k": 2.5, "d": 0.1}
"""Greatest gain of a motor, and its greatest delay, s."""
STRENGTH = (1.5, 4.0)
"""Hidden torque over what the baseline leaves, root mean square."""


@dataclass(frozen=True)
class Drawn:
    """What a method is given, and the truth, which it is not.

    Attributes:
        model: the simulator.
        new: recordings in which something may be concealed.
        baseline: the others of the rig.
        truth: the effect; None if nothing is concealed.
    """

    model: mujoco.MjModel
    new: Sequence[Recording]
    baseline: Sequence[Recording]
    truth: Effect | None


def draw(runs: Runs, folder: Path, rng: np.random.Generator, nulls: float) -> Drawn:
    """One comparison of the runs of a rig, with nothing concealed in a share of cases.

    Raises:
        InputError: if a file of the rig is missing or damaged.
    """
    model, recordings = runs.simulator(folder), [f.recording(folder) for f in runs.files]
    order = [recordings[i] for i in rng.permutation(len(recordings))]
    number = int(rng.integers(1, 3)) if len(order) > 4 else 1
    new, baseline, truth = order[:number], order[number:], None
    if rng.random() >= nulls:
        truth, new = hidden(new, model, runs.left * rng.uniform(*STRENGTH), rng)
    return Drawn(model, new, baseline, truth)


def hidden(
    new: Sequence[Recording], model: mujoco.MjModel, torque: float, rng: np.random.Generator
) -> tuple[Effect, list[Recording]]:
    """An effect whose torque has this root mean square, N m, and the recordings in which it is concealed."""
    while True:
        kind = EFFECTS[str(rng.choice(sorted(SHAPES)))]
        places = kind.candidates(model)
        effect = places[int(rng.integers(len(places)))]
        drawn = {"w": float(rng.uniform(3, 12)), "n": float(rng.integers(2, 8))}
        own = {p.name for p in effect.parameters()}
        shape = dict(SHAPES[kind.id]) | {name: value for name, value in drawn.items() if name in own}
        factor = 1.0
        try:
            for _ in range(8):
                sized = _sized(effect, shape, factor)
                concealed = [conceal(r, model, sized) for r in new]
                now = float(np.sqrt(np.mean([np.max(c.hidden) ** 2 for c in concealed])))
                if abs(now / torque - 1) < 0.02:
                    return sized, [c.recording for c in concealed]
                factor *= float(np.clip(torque / max(now, 1e-9), 0.2, 5))
                if any(abs(_sized(effect, shape, factor).__dict__[n]) > most for n, most in MOST.items() if n in own):
                    break
        except InputError:
            pass  # what cannot be concealed is drawn anew


def _sized(effect: Effect, shape: Mapping[str, float], factor: float) -> Effect:
    absent = {p.name: p.absent for p in effect.parameters()}
    return replace(
        effect,
        **{n: v if n in FIXED else absent[n] + (v - absent[n]) * factor for n, v in shape.items()},
    )
