"""Joint models on real logs as a table, and who wins where."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from keycld_control.delan.real import MODELS
from keycld_control.delan.rollouts import SECONDS
from keycld_control.paper.tables import Table
from keycld_envs.files import atomic_file

Result = Mapping[str, Any]
INDEFINITE = "indefinite"
Group = tuple[str, float, float]
"""Rig, share of the training recordings, and band."""


def write_table(out: Path, results: Sequence[Result]) -> None:
    """Write real.md from what has been measured so far."""
    with atomic_file(out / "real.md", "w") as file:
        file.write(real_table(results).markdown())


def groups(results: Sequence[Result]) -> list[Group]:
    """What is comparable, in the order in which it was measured."""
    return list(dict.fromkeys((r["rig"], r["share"], r["band"]) for r in results))


def errors(results: Sequence[Result], group: Group, model: str, measure: str = "torque") -> list[float]:
    """Of each seed of a model.

    Args:
        results: all.
        group: those that are meant.
        model: the same.
        measure: "torque", a share of the variance, or "rollout", the median in 1e-3 rad or m, infinite where most
            rollouts run away.
    """
    own = [r for r in results if (r["rig"], r["share"], r["band"]) == group and r["model"] == model]
    own = [r for r in own if r["torque_share"] is not None]  # the data suited the model
    if measure == "torque":
        return [r["torque_share"] for r in own]
    medians = [r["rollouts"]["median"] if r["rollouts"] else None for r in own]
    return [float("inf") if median is None else median for median in medians]


def winners(results: Sequence[Result]) -> list[dict[str, Any]]:
    """The best model of each group by torques, and by rollouts; means over seeds. One model alone wins nothing."""
    found = []
    for group in groups(results):
        if sum(bool(errors(results, group, model)) for model in MODELS) < 2:
            continue
        best = {}
        for measure in ("torque", "rollout"):
            means = {m: np.mean(e) for m in MODELS if (e := errors(results, group, m, measure))}
            best[measure] = min(means, key=lambda m: means[m])
        found.append(dict(zip(("rig", "share", "band"), group, strict=True)) | best)
    return found


def real_table(results: Sequence[Result]) -> Table:
    """Errors on held-out recordings; the best of a row is bold."""
    models = [m for m in MODELS if any(r["model"] == m for r in results)]
    best_of = {(best["rig"], best["share"], best["band"]): best for best in winners(results)}
    rows = []
    for group in groups(results):
        best, cells = best_of.get(group, {}), []
        for model in models:
            torque, rollout = (errors(results, group, model, measure) for measure in ("torque", "rollout"))
            followed = INDEFINITE if _indefinite(results, group, model) else _mean(rollout, "{:.0f}")
            texts = [
                f"**{text}**" if best.get(measure) == model else text
                for measure, text in (("torque", _mean(torque, "{:.3f}")), ("rollout", followed))
            ]
            cells.append(", ".join(texts))
        rows.append((group[0], f"{group[1]:.0%}", f"{group[2]:g} Hz", *cells))
    return Table(
        "Joint models on held-out real recordings",
        "Squared error of torques over their variance, mean of the joints; then the median over rollouts of "
        f"{SECONDS:g} s of the root mean square error of positions, 1e-3 rad. Means over seeds. The share is of each "
        f"training recording, from its start. {INDEFINITE.capitalize()}: inertias that are not positive at most of the "
        "held-out samples, so that no rollout means anything.",
        ("rig", "training data", "band", *(MODELS[m] for m in models)),
        tuple(rows),
    )


def _indefinite(results: Sequence[Result], group: Group, model: str) -> bool:
    """Whether a model of some seed has inertias of which no rollout means anything."""
    own = [r for r in results if (r["rig"], r["share"], r["band"]) == group and r["model"] == model]
    return any(r["torque_share"] is not None and r["rollouts"] is None for r in own)


def _mean(values: Sequence[float], form: str) -> str:
    return form.format(np.mean(values)) if values else "–"
