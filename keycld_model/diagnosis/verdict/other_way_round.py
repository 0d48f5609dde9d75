"""Columns that count the other way round, or from another body, which is no physics."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from keycld_envs.progress import progress
from keycld_envs.recordings import Recording
from keycld_model.diagnosis.criteria import Criteria
from keycld_model.diagnosis.inputs.observation import Observation
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.diagnosis.search.explain import refit
from keycld_model.diagnosis.simulation.simulator import Simulator
from keycld_model.diagnosis.verdict.dropped import Dropped

Change = Callable[[Recording], Recording]


def other_way_round(
    recordings: Sequence[Recording], observation: Observation, simulator: Simulator, criteria: Criteria
) -> str | None:
    """What has to be changed in the recordings for the refitted simulator to come far nearer to them.

    Args:
        recordings: to fit to, thinned; their misfit is far above the noise.
        observation: what is measured in them.
        simulator: whose nuisances are refitted.
        criteria: thresholds.

    Returns:
        A sentence; None if nothing helps, or the misfit is not so large.
    """
    dropped = Dropped()

    def misfit(change: Change) -> float:
        changed = cut([change(r) for r in recordings], observation, simulator.step, criteria.sizes.window)
        found = dropped.tried("other way round", lambda: refit(simulator, changed).chi_square)
        return np.inf if found is None or not np.isfinite(found) else found

    usual = misfit(lambda recording: recording)
    if not criteria.far_above_noise <= usual < np.inf:
        return None
    changes, tried = list(_changes(simulator.model, recordings)), {}
    with progress("Reading columns otherwise", total=len(changes)) as advance:
        for words, change in changes:
            tried[words] = misfit(change)
            advance()
    best = min(tried.values(), default=np.inf)
    if best > criteria.otherwise * usual:
        return None
    likely = " or ".join(words for words, left in tried.items() if left <= 2 * best)
    return (
        f"Probably {likely}: with that changed, the refitted simulator comes {np.sqrt(usual / best):.0f} times nearer "
        "to the recordings."
    )


def _changes(model: mujoco.MjModel, recordings: Sequence[Recording]) -> Iterator[tuple[str, Change]]:
    """What is written down wrongly now and then, in words, and how to change it back."""
    told = np.any([np.any(np.asarray(r.action) != 0, axis=0) for r in recordings if r.action is not None], axis=0)
    active = np.flatnonzero(told) if model.nu else np.zeros(0, int)
    for i in active:
        yield f"the commands of {model.actuator(int(i)).name!r} count the other way round", _commands([int(i)])
    if len(active) > 1:
        yield "all commands count the other way round", _commands(active.tolist())
    for j in range(model.njnt):
        yield f"the positions of {model.joint(j).name!r} count the other way round", _positions(j)
    for j in range(1, model.njnt):
        if _turns_on(model, j):
            name = model.joint(j).name
            yield f"the positions of {name!r} count from the ground, not from its link", _from_ground(j)


def _commands(columns: list[int]) -> Change:
    def change(recording: Recording) -> Recording:
        action = np.array(recording.action, np.float64)
        action[:, columns] *= -1
        return replace(recording, action=action)

    return change


def _positions(j: int) -> Change:
    def change(recording: Recording) -> Recording:
        qpos = np.array(recording.qpos, np.float64)
        qpos[:, j] *= -1
        return replace(recording, qpos=qpos, qvel=None)

    return change


def _from_ground(j: int) -> Change:
    def change(recording: Recording) -> Recording:
        qpos = np.array(recording.qpos, np.float64)
        qpos[:, j] -= qpos[:, j - 1]
        return replace(recording, qpos=qpos, qvel=None)

    return change


def _turns_on(model: mujoco.MjModel, j: int) -> bool:
    """Whether a joint is the hinge that follows on another one in a chain."""
    both = model.jnt_type[j - 1 : j + 1] == mujoco.mjtJoint.mjJNT_HINGE
    return bool(both.all() and model.body_parentid[model.jnt_bodyid[j]] == model.jnt_bodyid[j - 1])
