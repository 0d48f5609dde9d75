"""All joint models on the logs of other people's robots; every model leaves a line, so that nothing is done twice."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from keycld_control.benchmarks.json_lines import add_line, read_lines
from keycld_control.benchmarks.unfinished import finish
from keycld_control.delan.families import trained
from keycld_control.delan.logs import all_logs
from keycld_control.delan.plan import TITLES
from keycld_control.delan.rollouts import rollouts
from keycld_control.delan.simulators import METHODS, Simulated
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.delan import JointModel, Motions
from keycld_model.delan.measures import indefinite, variance_share

SCHEMA, FILE = "keycld.delan-real/2", "results.jsonl"
BAND = 6.0
"""Hz: links of the double pendulum vibrate at 8 to 12 (docs/notebook/2026-11-25-vibrations.md)."""
MODELS = TITLES | {"sysid": "simulator, mujoco.sysid", "corrected": "simulator, corrected by the diagnosis"}
"""Models of the table, by name."""
SHARES = (1.0, 0.25)
"""Of each training recording, from its start, as if it had been stopped there."""
MOSTLY = 0.5
"""Share of held-out samples with inertias that are not positive, beyond which the median of rollouts means nothing."""
FRICTION = ("viscous_friction", "coulomb_friction")
"""Of every model but feed-forward networks, which learn it: no Lagrangian or Hamiltonian has any."""


@dataclass(frozen=True, order=True)
class Trial:
    """One model to be trained and measured.

    Attributes:
        rig: name of `logs.all_logs`.
        model: preset, "least_squares", or a method of `simulators`.
        share: of each training recording.
        seed: of initialisation, and of the tenths of recordings that say when to stop.
        band: Hz, of all signals.
    """

    rig: str
    model: str
    share: float = 1.0
    seed: int = 0
    band: float = BAND

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.rig.replace(' ', '-')}-{self.model}-{self.share:g}-{self.seed}-{self.band:g}Hz"


def trials(
    rigs: Sequence[str] = (),
    models: Sequence[str] = (),
    shares: Sequence[float] = (),
    seeds: int = 1,
    band: float = BAND,
) -> list[Trial]:
    """All combinations; by default of everything.

    Raises:
        InputError: if a name is unknown, or a number out of range.
    """
    for option, names, known in (("--rig", rigs, list(all_logs())), ("--model", models, list(MODELS))):
        if unknown := [name for name in names if name not in known]:
            raise InputError(f"{option} names {unknown[0]!r}; there are {', '.join(known)}.")
    if bad := [share for share in shares if not 0 < share <= 1]:
        raise InputError(f"--share is {bad[0]:g}; it must be above 0, and 1 at most.")
    if seeds < 1 or not band > 0:
        raise InputError(f"--seeds is {seeds} and --band {band:g}; seeds must be 1 or more, and the band positive.")
    planned = [
        Trial(rig, model, share, seed, band)
        for rig in rigs or all_logs()
        for share in shares or SHARES
        for model in models or MODELS
        if model not in METHODS or all_logs()[rig].rig is not None
        for seed in range(1 if model in ("least_squares", *METHODS) else seeds)
    ]
    if not planned:
        raise InputError(
            f"There is no simulator of {', '.join(rigs)}; leave out {', '.join(METHODS)}, or name other rigs."
        )
    return planned


def work_off(out: Path, data: Path, planned: Sequence[Trial], workers: int = 1, ray: str | None = None) -> None:
    """Do what is missing.

    Args:
        out: folder of the results.
        data: folder with the data sets.
        planned: what is to be done.
        workers: processes.
        ray: address of a Ray cluster to do it on instead.

    Raises:
        InputError: if a file is missing or damaged.
    """
    out, data = out.resolve(), data.resolve()
    one = partial(_do, out, data, planned)
    finish(one, range(len(planned)), lambda: _done(out, planned), out, "Models", workers, ray)


def results(out: Path) -> list[dict[str, Any]]:
    """All figures that are there.

    Raises:
        InputError: if a line is damaged, or of another version.
    """
    found = read_lines(out / FILE)
    for number, line in enumerate(found, 1):
        if line.get("schema") != SCHEMA:
            raise InputError(f"{out / FILE}, line {number}: this version reads {SCHEMA!r}; remove the line.")
    return found


def _done(out: Path, planned: Sequence[Trial]) -> set[int]:
    fields = tuple(asdict(planned[0]))
    known = {tuple(line[field] for field in fields) for line in results(out)}
    return {i for i, trial in enumerate(planned) if tuple(asdict(trial).values()) in known}


@cache
def _motions(rig: str, data: Path, band: float) -> tuple[Motions, Motions]:
    return all_logs()[rig].motions(data, band)


def _do(out: Path, data: Path, planned: Sequence[Trial], number: int) -> None:
    """Train a model, measure it on the held-out recordings, and add the line; also of one that the data do not suit."""
    trial = planned[number]
    whole, held_out = _motions(trial.rig, data, trial.band)
    motions = whole.beginning(trial.share)
    line = {
        "schema": SCHEMA,
        **asdict(trial),
        "samples": len(motions.all("q")),
        "held_out": list(held_out.ids),
    }
    try:
        measured = _measured(trial, motions, held_out, out, data)
    except InputError as error:
        measured = {"failure": str(error), "torque_share": None, "rollouts": None}
    add_line(out / FILE, line | measured)


def _measured(trial: Trial, motions: Motions, held_out: Motions, out: Path, data: Path) -> dict[str, Any]:
    """Errors on held-out motions, and what was found."""
    usual = float(np.sqrt(np.mean(np.square(motions.scales().position))))
    q, v, a, tau = (held_out.all(name) for name in ("q", "v", "a", "tau"))
    if trial.model in METHODS:
        model, about = _simulator(trial, data)
    else:
        model, about = _trained(trial, motions, out)
        about |= {"acceleration_share": variance_share(model.forward_dynamics(q, v, tau), a)}
        about |= {"indefinite": indefinite(model, q) if model.conserves else None}
    found = model.inverse_dynamics(q, v, a)
    each = np.mean((found - tau) ** 2, axis=0) / tau.var(axis=0)
    return {
        "failure": None,
        **about,
        "torque_share": variance_share(found, tau),
        "torque_share_of": dict(zip(held_out.joints, each.tolist(), strict=True)),
        "rollouts": None if (about.get("indefinite") or 0.0) > MOSTLY else asdict(rollouts(model, held_out, usual)),
        "effects": {
            f"{e.id} at {e.where}": {p.name: getattr(e, p.name) for p in e.parameters()} for e in model.effects
        },
    }


def _trained(trial: Trial, motions: Motions, out: Path) -> tuple[JointModel, dict[str, Any]]:
    """A joint model."""
    by_parts = motions if trial.model == "least_squares" else motions.cut()
    friction = () if trial.model == "feed_forward" else FRICTION
    return trained(trial.model, by_parts, out / "models" / trial.name, trial.seed, friction)


def _simulator(trial: Trial, data: Path) -> tuple[Simulated, dict[str, Any]]:
    """A simulator that was fitted to recordings as they are, without a band."""
    logs, started = all_logs()[trial.rig], time.perf_counter()
    model = logs.simulator(data)
    if model is None:
        raise InputError(f"--rig {trial.rig} has no simulator; leave out {', '.join(METHODS)}.")
    recordings = [beginning(file.recording(data), trial.share) for file in logs.training]
    found = METHODS[trial.model](recordings, model)
    return found, {"seconds": round(time.perf_counter() - started, 1), "iterations": None}


def beginning(recording: Recording, share: float) -> Recording:
    """The first part of a recording, a share of its time."""
    t, u = np.asarray(recording.t_state), np.asarray(recording.t_action)
    end = t[0] + share * (t[-1] - t[0])
    states, actions = t <= end, u <= end
    kept = {name: getattr(recording, name)[states] for name in ("t_state", "qpos")}
    if recording.qvel is not None:
        kept["qvel"] = recording.qvel[states]
    kept |= {"t_action": u[actions], "action": np.asarray(recording.action)[actions]}
    return replace(recording, **kept)
