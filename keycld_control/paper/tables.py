"""The figures of all models as tables: rows of text, for Markdown and for the page."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from keycld_control.paper.plan import AMOUNTS, PAPER_VPT, TITLES, WHOLE
from keycld_control.paper.recordings import PARTS, VARIED
from keycld_envs.systems import REFERENCE_SYSTEMS

Result = Mapping[str, Any]
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        title: above it.
        note: below it.
        columns: headings.
        rows: cells as text.
    """

    title: str
    note: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """As Markdown."""
        rows = [tuple(cell.replace("|", "\\|") for cell in row) for row in (self.columns, *self.rows)]
        lines = [rows[0], ("---",) * len(self.columns), *rows[1:]]
        text = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        return f"## {self.title}\n\n{text}\n\n{self.note}\n"


def vpt(results: Sequence[Result]) -> Table:
    """Table 1 of the paper beside ours."""
    rows = []
    for preset in TITLES:
        for system in REFERENCE_SYSTEMS:
            if not (found := chosen(results, system, preset)):
                continue
            scores = [r["table"] for r in found if "table" in r]
            published = PAPER_VPT.get(preset, {}).get(system)
            paper = "–" if published is None else f"{published:.2f}"
            cells = [interval([t[name] for t in scores]) for name in ("vpt_from_2", "vpt_from_5", "vpt_from_10")]
            index = interval([t["frame_index_from_2"] for t in scores], 1)
            count = f"{len(scores)} of {len(found)}"
            rows.append((TITLES[preset], system, paper, *cells, index, count))
    return Table(
        "Valid prediction time",
        "Fraction of 50 frames, mean over seeds with its 95 % interval (Student); the threshold is the error of the "
        "training data's mean frame. The frame index is that of the 2024 code, whose threshold comes from the data "
        "that are scored, from two frames. A training fails where a keypoint comes to stand still.",
        (
            "model",
            "system",
            "paper, 2 frames",
            "from 2 frames",
            "from 5 frames",
            "from 10 frames",
            "frame index",
            "seeds that trained",
        ),
        tuple(rows),
    )


def starts(results: Sequence[Result]) -> Table:
    """What finding a state is worth."""
    rows = []
    for system, found in with_measure(results, "starts"):
        ways = ("pixels", "keypoints", "difference", "one_step", "rest")
        rows.append((system, *(interval([r["starts"][way] for r in found]) for way in ways)))
    return Table(
        "How predictions start",
        "VPT with less and less of what this library adds: a trajectory fitted to keypoints and pixels of five frames; "
        "to their keypoints; position and velocity from two frames, as in the paper; and one step of the integrator "
        "per frame. Last, with what is true of these recordings and not of others: no velocity at the start.",
        (
            "system",
            "five frames, pixels",
            "five frames, keypoints",
            "two frames, difference",
            "and one step per frame",
            "at rest",
        ),
        tuple(rows),
    )


def amounts(results: Sequence[Result]) -> Table:
    """VPT by number of training sequences."""
    rows, systems = [], measured(results)
    for amount in (*AMOUNTS, WHOLE):
        cells = []
        for system in systems:
            found = [r["table"]["vpt_from_5"] for r in chosen(results, system, "default", amount) if "table" in r]
            cells.append(interval(found) if found else "–")
        if any(cell != "–" for cell in cells):
            rows.append((str(amount), *cells))
    note = "VPT from five frames; of fewer sequences, one seed."
    return Table("Training sequences", note, ("sequences", *systems), tuple(rows))


def actions(results: Sequence[Result]) -> Table:
    """What actions and starts like none of training do."""
    rows = []
    for part in ("test", *VARIED):
        for system, found in with_measure(results, "angles"):
            frames = [{"test": r["curve"], **r["varying"]}[part]["vpt"] for r in found]
            valid = [r["angles"][part]["mean"] for r in found]
            rows.append((PARTS[part].title, system, interval(frames), interval(valid)))
    return Table(
        "Other actions, other starts",
        "50 frames, from five. Angles are valid until one is wrong by more than 0.2 rad.",
        ("recordings", "system", "VPT", "angle VPT"),
        tuple(rows),
    )


def long(results: Sequence[Result]) -> Table:
    """Beyond 50 frames."""
    rows = []
    for system, found in with_measure(results, "long"):
        for i, title in enumerate(found[0]["long"]["lengths"]):
            parts = [r["long"]["lengths"][title] for r in found]
            cells = (interval([p[name] for p in parts]) for name in ("vpt", "angle_vpt"))
            informed = "–" if i else interval([float(np.mean(r["long"]["informed"])) for r in found])
            itself = "–" if i else f"{np.mean(found[0]['ceiling']):.3f}"
            rows.append((system, title, str(parts[0]["frames"]), *cells, informed, itself))
    return Table(
        "Beyond fifty frames",
        "Constant actions. T is the natural time sqrt(L/g). Angles are valid until one is wrong by more than 0.2 rad. "
        "The last column is that of the true mechanism from the true start, in steps ten times finer than those of the "
        "simulator that recorded it (one per frame). It is no upper bound: the pendulum's run ahead by half a step's "
        "acceleration, which looks like a velocity to a model that fits its start.",
        ("system", "time", "frames", "VPT", "angle VPT", "angle VPT from 20 frames", "the mechanism, finer"),
        tuple(rows),
    )


def chaos(results: Sequence[Result]) -> Table:
    """Angles against the time in which the true mechanism forgets."""
    rows = []
    for system, found in with_measure(results, "lyapunov"):
        time = found[0]["lyapunov"]["time"]
        middle = interval([r["lyapunov"]["median_valid"] for r in found], 2)
        greatest = interval([max(r["lyapunov"]["valid"]) for r in found], 1)
        rows.append((system, "–" if time is None else f"{time:.2f} s", middle, greatest))
    return Table(
        "Lyapunov times",
        "Of the true plant along 500 frames of the long recordings: one over the median of their largest exponents. "
        "How long angles are right, in Lyapunov times of the same recording; 500 frames at most. One joint under a "
        "constant torque is not chaotic, and forgets in no fixed time: the pendulum's is that of 500 frames.",
        ("system", "Lyapunov time", "median", "longest"),
        tuple(rows),
    )


def recall(results: Sequence[Result]) -> Table:
    """Whether predictions are memories."""
    rows = []
    for system, found in with_measure(results, "memory"):
        vpt, memory = interval([r["curve"]["vpt"] for r in found]), [r["memory"] for r in found]
        replay, rank = interval([m["replay_vpt"] for m in memory]), interval([m["spearman"] for m in memory], 2)
        rows.append((system, vpt, replay, rank, f"{min(m['p_value'] for m in memory):.2g}"))
    return Table(
        "Learned or remembered",
        "Replay shows the nearest training recording (start and action) in place of a prediction. Rank correlation of "
        "a test recording's error with its distance to the nearest training recording, and the smallest p-value of "
        "the seeds; strong actions are far from each other, and move faster, so that zero is not to be expected.",
        ("system", "VPT", "VPT of replay", "correlation", "p"),
        tuple(rows),
    )


def swing_ups(results: Sequence[Result]) -> Table:
    """The episodes whose frames are shown."""
    rows = []
    for system, found in with_measure(results, "swing_up"):
        for r in found:
            up = r["swing_up"]["upright_s"]
            rows.append((system, str(r["seed"]), "never" if up is None else f"{up:.1f} s"))
    return Table(
        "Swing-up from hanging (figure 5)",
        "One episode each, environment seed 0; `keycld swingup` counts hundreds.",
        ("system", "seed", "stays upright from"),
        tuple(rows),
    )


def sooner(results: Sequence[Result]) -> Table:
    """Training times."""
    rows = []
    for system, found in with_measure(results, "speed"):
        speeds = [r["speed"] for r in found]
        reached = [s for s in speeds if s["seconds"] is not None]
        ours, times = (interval([s[name] for s in reached], 0) for name in ("seconds", "times"))
        step = interval([s["reference_step"] for s in speeds], 2)
        rows.append((system, f"{speeds[0]['wanted']:.2f}", ours, step, times, f"{len(reached)} of {len(found)}"))
    return Table(
        "Time to the paper's VPT",
        "Seconds of training until a stage, or else the finished model, scored the paper's VPT or more on validation "
        "data, ours from five frames, the paper's from two; a training step of the paper's size, timed in the same "
        "process after the measures; 45,000 of them against ours.",
        ("system", "paper's VPT", "ours, s", "step of the paper's size, s", "times sooner", "seeds that reached it"),
        tuple(rows),
    )


def potential(results: Sequence[Result]) -> Table:
    """Shape of V, and masses."""
    rows = []
    for system, found in with_measure(results, "potential"):
        for k in range(len(found[0]["potential"])):
            sweeps = [r["potential"][k] for r in found]
            r2 = [s["r2"] for s in sweeps if s["r2"] is not None]
            shape = f"R² {interval(r2, 4)}" if r2 else f"changes by {interval([s['change'] for s in sweeps], 3)}"
            figure = sweeps[0]["figure"]
            rows.append((system, "–" if figure is None else str(figure), sweeps[0]["title"], shape))
        if not (masses := [r["masses"] for r in found if "masses" in r]):
            continue
        if masses[0]["exact"] is not None:
            text = f"{interval([m['ratio'] for m in masses])}, exact {masses[0]['exact']:.3g}"
            rows.append((system, "–", "m1/m2", text))
        for i in range(len(masses[0]["lengths"])):
            rows.append(
                (system, "–", f"length of rod {i + 1}, learned/exact", interval([m["lengths"][i] for m in masses]))
            )
        rows.append((system, "–", "potential per mass, learned/exact", interval([m["potential"] for m in masses])))
    return Table(
        "Potential energy and masses",
        "Scale and offset of V are fixed by least squares, one scale for all sweeps of a system. Where the true "
        "potential is constant: range of V relative to the other sweep's. Exact are the point masses that move as the "
        "bodies do; V and masses share a factor that motion leaves open, so that their ratio counts.",
        ("system", "figure", "what moves", "against the truth"),
        tuple(rows),
    )


def states(results: Sequence[Result]) -> Table:
    """Whether predicted states are possible ones."""
    rows = []
    for system, found in with_measure(results, "long"):
        changes = np.concatenate([r["long"]["true_energy"] for r in found])
        off = max(r["long"]["off_constraints"] for r in found)
        rows.append((system, worst(changes), f"{len(changes) // len(found)}", f"{off:.1e}"))
    return Table(
        "Predicted states over 1,000 frames",
        "Energy of the true bodies at joint positions decoded from predicted keypoints, speeds by differences: largest "
        "change, median and worst of the recordings without actions and of the seeds, relative to the range of the "
        "true potential. Distance of predicted keypoints from the constraints, |Phi|: median over recordings of the "
        "greatest, worst seed.",
        ("system", "change of true energy", "recordings", "median |Phi|"),
        tuple(rows),
    )


def integrators(results: Sequence[Result]) -> Table:
    """Drift of the learned energy."""
    rows = []
    for system, found in with_measure(results, "integrators"):
        for name in found[0]["integrators"]:
            parts = [r["integrators"][name] for r in found]
            cells = (worst(np.concatenate([p[key] for p in parts])) for key in ("change", "drift"))
            off = max(number(p["off_constraints"]) for p in parts)
            rows.append((system, name, *cells, f"{off:.1e}"))
    return Table(
        "Energy over 1,000 steps without actions",
        "Median and worst of ten starts per seed, relative to the range of V along the way: largest change, and drift "
        "of the mean from the first to the last tenth.",
        ("system", "integrator", "change", "drift", "median off the constraints"),
        tuple(rows),
    )


def chosen(results: Iterable[Result], system: str, preset: str, sequences: int = WHOLE) -> list[Result]:
    """All seeds of one model."""
    wanted = (system, preset, sequences)
    return [r for r in results if (r["system"], r["preset"], r["sequences"]) == wanted]


def measured(results: Iterable[Result]) -> tuple[str, ...]:
    """Systems that have any figures."""
    there = {r["system"] for r in results}
    return tuple(system for system in REFERENCE_SYSTEMS if system in there)


def with_measure(results: Sequence[Result], name: str) -> Iterator[tuple[str, list[Result]]]:
    """Every system with the seeds of the default that have a measure, if any."""
    for system in REFERENCE_SYSTEMS:
        if found := [r for r in chosen(results, system, "default") if name in r]:
            yield system, found


def interval(values: Sequence[float], digits: int = 3) -> str:
    """Mean with its interval over seeds."""
    if not values:
        return "–"
    mean = float(np.mean(values))
    if len(values) < 2:
        return f"{mean:.{digits}f}"
    spread = stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * stats.sem(values)
    return f"{mean:.{digits}f} ± {spread:.{digits}f}"


def worst(values: Iterable[float | None]) -> str:
    """Median and greatest."""
    numbers = [number(v) for v in values]
    return f"{np.median(numbers):.2g}, {np.max(numbers):.2g}"


def number(value: float | None) -> float:
    """What diverged is infinite; JSON has no word for it."""
    return np.inf if value is None else value
