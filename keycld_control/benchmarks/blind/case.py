"""One case: everything drawn, and the recordings that it makes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.blind.excite import Excitation, drive, ticks_and_times
from keycld_control.benchmarks.blind.film import RATE, SIZE, Film, Studio
from keycld_control.benchmarks.blind.mechanism import Array, CaseMechanism
from keycld_control.benchmarks.blind.outside_strengths import OUTSIDE
from keycld_control.benchmarks.blind.parameter_errors import ParameterErrors, draw_errors
from keycld_control.benchmarks.blind.plan import Plan
from keycld_control.benchmarks.blind.plant import CasePlant
from keycld_control.benchmarks.blind.sites import environment_of
from keycld_control.benchmarks.blind.strengths import LIBRARY
from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system

TRAINING, HELD_OUT = 8, 4
"""Numbers of recordings."""
SECONDS = 4.0
"""Length of each recording."""
MAX_SPEED = 15.0
"""Greatest speed, rad/s or m/s; faster runs are drawn again with less excitation."""
MIN_MOTION = 0.3
"""How far at least one joint must move in the training recordings, rad or m."""
ATTEMPTS = 10
"""How often a run that is too fast is drawn."""
FRAMES = 40
"""Number of frames from which is told how exactly frames show positions."""
STREAMS = ("drive", "mechanisms", "noise", "film")


@dataclass(frozen=True)
class Signals:
    """One run before noise.

    Attributes:
        t_action: `[Ta]` times at which commands change, s.
        action: `[Ta, nu]` commands.
        t_state: `[Ts]` times of samples, s.
        true: `[Ts, nv]` positions that a perfect sensor would show, rad or m.
        noise: `[Ts, nv]` zeros of the encoders and noise, rad or m.
        level: of the excitation.
        attempt: how often the run was drawn before.
    """

    t_action: Array
    action: Array
    t_state: Array
    true: Array
    noise: Array
    level: float
    attempt: int


@dataclass(frozen=True)
class SealedCase:
    """What is drawn once for all recordings of a case.

    Attributes:
        plan: system, excitation, and what is missing where.
        entropy: seeds of everything drawn per recording.
        errors: of the simulator's masses and lengths.
        zero: `[nv]` zeros of the encoders, rad or m.
        noise: `[nv]` standard deviation of the sensors, rad or m.
        rate: samples and commands per second.
        jitter: whether clocks are irregular.
        smooth: training commands are sums of sines rather than steps; held-out ones the reverse.
        levels: of the excitation of each recording, training first.
        driven: the recording that is driven where all others are passive.
        mechanisms: what the simulator lacks.
        film: how a camera shows it; None where encoders are recorded.
    """

    plan: Plan
    entropy: tuple[int, ...]
    errors: ParameterErrors
    zero: Array
    noise: Array
    rate: float
    jitter: bool
    smooth: bool
    levels: Array
    driven: int
    mechanisms: tuple[CaseMechanism, ...]
    film: Film | None = None

    def excitation(self, run: int) -> Excitation:
        """How one recording is moved."""
        if self.plan.excitation != "mixed":
            return self.plan.excitation
        return "open_loop" if run == self.driven else "passive"

    @cached_property
    def plant(self) -> CasePlant:
        """The mechanism with all that the simulator lacks."""
        model = get_system(self.plan.system).compile()
        self.errors.apply(model)
        return CasePlant(model, self.mechanisms)

    def with_only(self, mechanism: CaseMechanism) -> "SealedCase":
        """The same draws with one missing mechanism alone."""
        return replace(self, mechanisms=(mechanism,))

    def stream(self, run: int, attempt: int, name: str) -> np.random.Generator:
        """Random numbers of one recording for one of `STREAMS`."""
        return np.random.default_rng([*self.entropy, run, attempt, STREAMS.index(name)])

    def simulate(self, runs: Sequence[int]) -> list[Signals] | None:
        """The recordings of these indices; None if one stays too fast, or the training ones hardly move."""
        out = []
        for run in runs:
            if (signals := self._run(run)) is None:
                return None
            out.append(signals)
        moved = [np.ptp(s.true, axis=0).max() for run, s in zip(runs, out, strict=True) if run < TRAINING]
        return out if not moved or max(moved) > MIN_MOTION else None

    def _run(self, run: int) -> Signals | None:
        plan = self.plan
        for attempt in range(ATTEMPTS):
            rng = self.stream(run, attempt, "drive")
            level = float(self.levels[run]) * 0.85**attempt
            ticks, times = ticks_and_times(self.rate, SECONDS, self.jitter, rng)
            clock = ticks.astype(np.float64) / 1e3
            smooth = self.smooth == (run < TRAINING)
            chosen = drive(plan.system, self.excitation(run), level, smooth, clock, self.noise, self.zero, rng)
            draws = self.stream(run, attempt, "mechanisms")
            path = self.plant.simulate(chosen.q, chosen.v, ticks, chosen.controller, draws, SECONDS, MAX_SPEED)
            if path is not None:
                true = path.at(self.plant.measured_times(times))
                noise = self.zero + self.stream(run, attempt, "noise").normal(0, self.noise, true.shape)
                return Signals(clock, path.commands, times, true, noise, level, attempt)
        return None


def reading_deviation(case: SealedCase, signals: Sequence[Signals], studio: Studio) -> Array:
    """Least standard deviations `[nv]` of positions that frames allow, rad or m; see `Studio.reading_deviation`."""
    assert case.film is not None
    positions = np.concatenate([s.true for s in signals])
    some = np.linspace(0, len(positions) - 1, FRAMES).round().astype(int)
    return studio.reading_deviation(positions[some], case.film, np.random.default_rng([*case.entropy, len(STREAMS)]))


def draw_case(plan: Plan, entropy: Sequence[int], filmed: bool = False) -> tuple[SealedCase, list[Signals]]:
    """Draw a case and simulate all its recordings; the numbers are drawn again while it is too fast or too still.

    Args:
        plan: what the case is.
        entropy: seeds of all that is drawn.
        filmed: a camera looks, at its own rate, in place of encoders.
    """
    model = get_system(plan.system).compile()
    for attempt in range(50):
        rng = np.random.default_rng([*entropy, attempt])
        case = _draw(plan, (*entropy, attempt), model, rng)
        if filmed:
            case = replace(case, rate=RATE, film=Film.draw(rng))
        if (signals := case.simulate(range(TRAINING + HELD_OUT))) is not None:
            return case, signals
    raise RuntimeError(f"No excitation suits {plan}.")


def _draw(plan: Plan, entropy: tuple[int, ...], model: mujoco.MjModel, rng: np.random.Generator) -> SealedCase:
    driven, nv = plan.excitation != "passive", model.nv
    errors = draw_errors(model, rng)
    library = OUTSIDE if plan.category == "outside" else LIBRARY
    level = np.exp(rng.uniform(np.log(2e-4), np.log(3e-3)))
    return SealedCase(
        plan,
        entropy,
        errors,
        zero=rng.normal(0, 0.01, nv),
        noise=level * rng.uniform(0.8, 1.25, nv),
        rate=float(rng.choice([50.0, 100.0])),
        jitter=bool(rng.random() < 1 / 3),
        smooth=bool(rng.random() < 0.5),
        levels=_levels(rng),
        driven=int(rng.integers(TRAINING + HELD_OUT)),
        mechanisms=tuple(library[name](site, rng, driven) for name, site in plan.parts),
    )


def _levels(rng: np.random.Generator) -> NDArray[np.float64]:
    """Excitation of training recordings between .35 and 1, of held-out ones around and above these."""
    return np.concatenate([rng.permutation(np.linspace(0.35, 1.0, TRAINING)), rng.permutation([0.5, 0.8, 1.15, 1.3])])


def recording(case: SealedCase, run: int, signals: Signals, studio: Studio | None = None) -> Recording:
    """The recording without anything that tells what is missing: of encoders, or of a camera in a studio."""
    declared = get_system(case.plan.system)
    units = tuple("m" if joint.kind == "slide" else "rad" for joint in declared.joints)
    common = {
        "id": f"{run + 1:02d}",
        "system": environment_of(case.plan.system),
        "source": "simulation",
        "joint_names": tuple(joint.name for joint in declared.joints),
        "actuator_names": declared.actuators,
        "licence": "Apache-2.0",
        "origin": "keycld blind",
        "t_action": signals.t_action,
        "action": signals.action,
    }
    if studio is None or case.film is None:
        seen = signals.true + signals.noise
        return Recording(**common, units={"action": "1", "qpos": units}, t_state=signals.t_state, qpos=seen)
    return Recording(
        **common,
        units={"action": "1"},
        camera={"name": declared.camera, "width": SIZE, "height": SIZE},
        render_quality="fast",
        t_frame=signals.t_state,
        frames=studio.shoot(signals.true, case.film, case.stream(run, signals.attempt, "film")),
    )
