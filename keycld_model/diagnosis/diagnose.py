"""The whole diagnosis: its stages in order."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from keycld_envs.command_limits import beyond_limits
from keycld_envs.errors import InputError
from keycld_envs.progress import progress
from keycld_envs.recordings import Recording
from keycld_model.delan.model import JointModel
from keycld_model.delan.rig import learned_dynamics
from keycld_model.diagnosis.criteria import STANDARD, Criteria
from keycld_model.diagnosis.discrepancy.checks import check_alike
from keycld_model.diagnosis.discrepancy.compare import compare
from keycld_model.diagnosis.discrepancy.motion import MOST
from keycld_model.diagnosis.discrepancy.one_set import lacking
from keycld_model.diagnosis.discrepancy.outcome import report_of
from keycld_model.diagnosis.estimation.fit import Fit
from keycld_model.diagnosis.estimation.replay import rollout_error
from keycld_model.diagnosis.inputs.checks import check, check_apart
from keycld_model.diagnosis.inputs.joint_model import simulator_of
from keycld_model.diagnosis.inputs.observation import BoundedNoise, JointPositions, Observation
from keycld_model.diagnosis.inputs.prepare import accurate_step, ready, split, uncommanded
from keycld_model.diagnosis.inputs.ranges import Paths, beyond, notable
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.diagnosis.output.words import headline
from keycld_model.diagnosis.search.budget import Budget
from keycld_model.diagnosis.search.criterion import Scored, share_left
from keycld_model.diagnosis.search.explain import Explanation, explain_either, refit, refit_accurately
from keycld_model.diagnosis.simulation.contacts import without_contacts
from keycld_model.diagnosis.simulation.places import not_asked
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.decide import (
    Conclusion,
    Rollouts,
    decide_on_named,
    decide_on_residual,
    doubted,
    never_worse,
    settled,
)
from keycld_model.diagnosis.verdict.dropped import Dropped
from keycld_model.diagnosis.verdict.evidence import evidence
from keycld_model.diagnosis.verdict.findings import (
    calibrated,
    far_off,
    findings_of,
    nuisance_of,
    pulses_of,
    unexplained_of,
)
from keycld_model.diagnosis.verdict.held_out import HeldOut
from keycld_model.diagnosis.verdict.other_way_round import other_way_round
from keycld_model.diagnosis.verdict.report import FitErrors, Report, Unexplained
from keycld_model.diagnosis.verdict.rivals import Rivals
from keycld_model.rigid_body.residual_force import ResidualForce


def diagnose(
    recordings: Sequence[Recording],
    model: mujoco.MjModel | JointModel,
    held_out: Sequence[Recording] = (),
    tracked: bool = False,
    observation: Observation | None = None,
    criteria: Criteria = STANDARD,
    baseline: Sequence[Recording] = (),
    budget: float | None = None,
) -> Report:
    """Find physics that a simulator lacks.

    Args:
        recordings: what was observed, and commands; a third of them is held out unless `held_out` is given.
        model: the simulator, of hinges and slides; or a joint model, with its learned friction. It has no bodies:
            one factor of all its energies is refitted in place of masses and lengths, and `details["not_asked"]` lists
            what is of bodies and is not looked for.
        held_out: recordings to test findings on, of other amplitudes and inputs.
        tracked: joint positions were read off images of a camera, whose errors are refitted, too: a view askew, and a
            shutter that rolls.
        observation: what is measured in the recordings; joint positions by default.
        criteria: thresholds and priors.
        baseline: recordings of the same mechanism from before, at least two. Findings are then what changed since, and
            what nobody modelled, which is in both, does no harm.
        budget: seconds after which the search ends with the best it has, at its next set of effects or change;
            `details` then has what was not tried.

    Returns:
        The report; `details["beyond_limits"]` tells of commands that the simulator cuts off.

    Raises:
        InputError: if there are both `tracked` and `observation`, if the recordings do not suit the model, or nothing
            can be learned from them; if the budget is no positive number.
    """
    spending = Budget(budget)
    if isinstance(model, JointModel):
        model = simulator_of(model, [*recordings, *held_out, *baseline])
    if baseline and (held_out or tracked or observation is not None):
        raise InputError(
            "A baseline is compared by positions of encoders, and parts of the recordings are held out by themselves; "
            "leave out held_out, tracked and observation."
        )
    about: dict[str, object] = {"beyond_limits": beyond_limits([*recordings, *held_out, *baseline], model)}
    if learned_dynamics(model) is not None:
        about["not_asked"] = not_asked(model)
    if baseline:
        report = _changed(recordings, baseline, model, criteria, spending)
        said = report.headline + uncommanded([*recordings, *baseline], model)
        about = {"not_tried": spending.not_tried, **about}
        return replace(report, headline=said, details={**report.details, **about})
    if tracked and observation is not None:
        raise InputError("tracked is of joint positions, but an observation is handed in; hand in one of them.")
    encoders = not tracked and observation is None
    if observation is None:
        observation = JointPositions(model, tracked=tracked, criteria=criteria)
    report = _lacking(recordings, held_out, model, observation, criteria, spending, encoders)
    said = report.headline + uncommanded([*recordings, *held_out], model)
    about = {"not_tried": spending.not_tried, "tracked": tracked, **about}
    return replace(report, headline=said, details={**report.details, **about})


def _lacking(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    model: mujoco.MjModel,
    observation: Observation,
    criteria: Criteria,
    budget: Budget,
    encoders: bool,
) -> Report:
    """What the simulator lacks; where its misfit to positions of encoders is far above noise, beside forces unknown."""
    training, test = _prepared(recordings, held_out, model, observation, criteria)
    observation = observation.calibrated(training)
    bare = without_contacts(model, [*training, *test], observation)
    if encoders:
        with progress("Weighing the misfit", total=100) as advance:
            report = lacking(recordings, held_out, bare, criteria, advance, budget.leaves_out)
        if report is not None:
            return _read_otherwise(report, training, observation, bare, criteria)
    with progress("Diagnosing", total=100) as advance:
        explained = _explained(bare, training, observation, criteria, budget, advance)
        report = _report(model, explained, test, budget, advance)
    return _read_otherwise(report, training, observation, bare, criteria) if encoders else report


def _read_otherwise(
    report: Report,
    training: Sequence[Recording],
    observation: Observation,
    model: mujoco.MjModel,
    criteria: Criteria,
) -> Report:
    """The report, undetermined and with a word in front, if recordings seem to be written down wrongly."""
    if not report.unexplained.significant and all(found.effect != ResidualForce.id for found in report.findings):
        return report
    simulator = Simulator(model, accurate_step(training), criteria=criteria)
    said = other_way_round(training, observation, simulator, criteria)
    if said is None:
        return report
    return replace(report, verdict="undetermined", headline=f"{said} As they are: {report.headline}")


def _changed(
    recordings: Sequence[Recording],
    baseline: Sequence[Recording],
    model: mujoco.MjModel,
    criteria: Criteria,
    budget: Budget,
) -> Report:
    """What is different since the baseline."""
    check_alike(recordings, baseline)
    observation = JointPositions(model, criteria=criteria)
    check([*recordings, *baseline], model, observation, MOST)
    bare = without_contacts(model, [*recordings, *baseline], observation)
    with progress("Comparing", total=100) as advance:
        try:
            found = compare(recordings, baseline, bare, criteria, advance, budget.leaves_out)
        except np.linalg.LinAlgError as error:
            raise InputError(
                f"The simulator cannot follow the motion of {recordings[0].id!r} and the others; check the units of "
                "qpos and action, and that their columns are those of the simulator's joints and actuators."
            ) from error
        return report_of(found, bare, [r.id for r in baseline], criteria, budget.not_tried)


def _report(
    model: mujoco.MjModel,
    explained: Explanation,
    test: Sequence[Recording],
    budget: Budget,
    advance: Callable[..., None],
) -> Report:
    """What held-out recordings say of what explains the others."""
    refitted, dropped = explained.refitted, Dropped()
    tested = HeldOut.of(test, refitted)
    before = tested.short(refitted)
    near = explained.search.near(explained.best)
    if near and not budget.leaves_out("sets nearly as good, on held-out recordings"):
        explained = settled(explained, near, tested)
    judged = _judged(explained, tested, before, dropped, budget, advance)
    weak = explained.of_weak_effect if judged.concluded.unknown else None
    if weak is not None and not budget.leaves_out("an effect in place of the unknown force"):
        again = _judged(weak, tested, before, dropped, budget, lambda *args: None)
        judged = judged if again.concluded.unknown else again
    explained, named, left = judged.explained, judged.named, judged.left
    advance(10, "proposing the next recording")
    concluded, rollouts = never_worse(judged.concluded, explained, tested)
    nothing = named.verdict == "undetermined"
    proposed = None
    if named.findings and not budget.leaves_out("the next recording"):
        proposed = judged.rivals.next_experiment(tested.samples, nothing)
    advance(5)
    errors = _errors(concluded, rollouts, tested)
    return Report(
        verdict=concluded.verdict,
        headline=headline(concluded.verdict, concluded.findings, errors, left, far_off(concluded.fit)),
        findings=calibrated(concluded.findings, left),
        nuisance=nuisance_of(concluded.fit),
        unexplained=left,
        fit=errors,
        held_out=[r.id for r in test],
        beyond_training=_beyond(refitted, before),
        next_experiment=proposed,
        details=_details(explained, concluded, dropped),
        evidence=evidence(model, (refitted, concluded.fit), (rollouts.refitted, rollouts.corrected)),
    )


class _Judged(NamedTuple):
    """An explanation, what rivals it, what held-out recordings say of its names, and beside a residual force."""

    explained: Explanation
    rivals: Rivals
    named: Conclusion
    left: Unexplained
    concluded: Conclusion


def _judged(
    explained: Explanation,
    tested: HeldOut,
    before: Fit,
    dropped: Dropped,
    budget: Budget,
    advance: Callable[..., None],
) -> _Judged:
    """What held-out recordings say, `before` being the refitted simulator on them."""
    rivals = Rivals.of(explained, dropped, budget)
    found = [*findings_of(explained, rivals), *pulses_of(explained.on_all_windows)]
    advance(10, "testing on held-out recordings")
    named = decide_on_named(explained, found, before, tested)
    left = _left(named, explained, before, tested)
    advance(5, "fitting a residual force")
    decided = None
    if not budget.leaves_out("a residual force"):
        decided = dropped.tried("residual force", lambda: decide_on_residual(named, explained, tested, left))
    return _Judged(explained, rivals, named, left, decided or doubted(named, left))


def _left(named: Conclusion, explained: Explanation, before: Fit, tested: HeldOut) -> Unexplained:
    """What named effects leave of held-out recordings, and of long rollouts, in which small errors of a form add up.

    Where nothing is named, nor may training recordings leave more than noise.
    """
    pairs = [(before, named.tested)]
    if named.verdict == "no_mismatch":
        pairs.append((explained.refitted, explained.refitted))
    if named.findings and not named.fit.point.variant.pulses:
        pairs.append((tested.long(explained.refitted), tested.continued(named.fit)))
    return unexplained_of(*pairs)


def _beyond(learned: Fit, tested: Fit) -> dict[str, float]:
    """Share of the time in which held-out recordings leave the range of those that were learned from, by channel."""
    known, paths = (Paths(*fit.problem.path(fit.point)) for fit in (learned, tested))
    found = beyond(learned.problem.simulator.model, known, paths)
    return notable({channel: float(b.mean()) for channel, b in found.items()})


def _prepared(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    model: mujoco.MjModel,
    observation: Observation,
    criteria: Criteria,
) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings, checked and thinned."""
    samples = criteria.sizes.window
    check([*recordings, *held_out], model, observation, samples)
    training, test = (ready(part, model, samples) for part in (recordings, held_out))
    training, test = (training, test) if held_out else split(training, observation, samples)
    check_apart(training, test)
    return training, test


def _explained(
    model: mujoco.MjModel,
    training: Sequence[Recording],
    observation: Observation,
    criteria: Criteria,
    budget: Budget,
    advance: Callable[..., None],
) -> Explanation:
    """What training recordings say, with an accurate integrator or with the model's own."""
    advance(0, "refitting masses, lengths and zeros")
    simulator = Simulator(model, accurate_step(training), criteria=criteria)
    windows = cut(training, observation, simulator.step, criteria.sizes.window)
    accurate = refit_accurately(simulator, windows)
    bounded = isinstance(observation, BoundedNoise)
    quieter = observation.as_left(share_left(accurate)) if bounded else observation
    if quieter is not observation:
        windows = cut(training, quieter, simulator.step, criteria.sizes.window)
        accurate = refit_accurately(simulator, windows)
    learned = learned_dynamics(model) is not None  # which has no integrator of its own
    own = accurate if learned else refit(Simulator(model, criteria=criteria), windows)
    advance(10, "searching")
    sets = _Sets(advance, budget, total=60)
    explained = explain_either(accurate, own, sets.refined, budget)
    sets.done()
    return explained


class _Sets:
    """Counts sets of effects that were refined, towards a usual number of them, within a budget."""

    def __init__(self, advance: Callable[..., None], budget: Budget, total: int) -> None:
        """With the steps of the bar that the search takes in all."""
        self._advance, self._budget, self._left, self._number, self._done = advance, budget, total, 0, False

    def refined(self, scored: Scored | None) -> None:
        """Show one more set, if one was refined, and see whether there is time for more."""
        if scored is not None:
            self._number += 1
            steps = 1 if self._left > 1 else 0
            self._left -= steps
            names = " + ".join(f"{e.id} at {e.where}" for e in scored.fit.effects) or "nothing"
            self._advance(steps, f"searching: set {self._number}, {names}")
        if not self._done:
            self._budget.check(self._number)

    def done(self) -> None:
        """Show the search as done; what follows is not ended."""
        self._done = True
        self._advance(self._left, "looking for rivals")


def _errors(concluded: Conclusion, rollouts: Rollouts, tested: HeldOut) -> FitErrors:
    """Of long rollouts over held-out recordings, in thousandths."""
    limits = rollouts if concluded.ceiling is None else [*rollouts, tested.long(concluded.ceiling)]
    return FitErrors.of(
        f"root mean square of rollouts over {tested.seconds:.2g} s with fitted initial states",
        tested.rollouts.windows.observation.units,
        [rollout_error(fit) for fit in limits],
    )


def _details(explained: Explanation, concluded: Conclusion, dropped: Sequence[str]) -> dict[str, object]:
    """Numbers of the fits, JSON-compatible."""
    refitted = explained.refitted
    simulator = refitted.problem.simulator
    return {
        "gain_nats": round(explained.gain, 2),
        "held_out_gain_nats": round(concluded.nats, 2),
        "chi_square": {"refitted": refitted.chi_square, "corrected": concluded.fit.chi_square},
        "dispersion": explained.search.dispersion,
        "noise": refitted.problem.noise.tolist(),
        "windows": len(refitted.problem.windows),
        "step_s": simulator.step,
        "integrator": mujoco.mjtIntegrator(simulator.model.opt.integrator).name,
        "dropped": list(dropped),
    }
