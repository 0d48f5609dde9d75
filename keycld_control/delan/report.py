"""One page and one table: the characters beside the published figures."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from plotly.subplots import make_subplots
from scipy import stats

from keycld_control.delan.plan import ALL, PUBLISHED, TITLES
from keycld_control.delan.work import characters
from keycld_control.paper.page import COLOURS, Picture, Section, figure_of, html_page
from keycld_control.paper.tables import CONFIDENCE, Table
from keycld_envs.files import atomic_file
from keycld_model.delan import JointModel

Result = Mapping[str, Any]
TITLE, COMMAND = "Deep Lagrangian Networks: the characters anew", "keycld delan paper"
MEASURES = {
    "torque": "torque, (N m)²",
    "inertial": "inertial, (N m)²",
    "coriolis": "Coriolis, (N m)²",
    "gravity": "gravity, (N m)²",
    "power": "power, W²",
    "valid_time": "valid rollout, s",
}
"""Columns of the table."""
DIFFERENCES = (
    "What differs from the reference. It takes 5,000 epochs of AdamW on networks of 2 × 64 units; here some tens of "
    "Levenberg-Marquardt steps in double precision fit networks of 2 × 24 units, which is why errors are lower: the "
    "data are without noise, and few weights explain them. Structured and Hamiltonian models have polynomials of "
    "cosines and sines beside their networks, in which a rigid arm is nearly linear, and inertias that do not hang on "
    "the first joint; the reference has neither. Characters that validate say when to stop; the reference has none. "
    "Its Hamiltonian network is given the momenta, which no robot measures; here they follow from "
    "velocities. Its README prints the inertial error as the gravitational one and belongs to an older file; "
    "published figures here are of its stored models on this file, means over ten seeds. A rollout is valid until the "
    "mean over joints of squared errors over the training positions' variance is 0.01; torques are held from sample "
    "to sample, which limits the exact model of the last row, too. Least squares of base parameters is exact on these "
    "data: they need no network."
)


def write_report(out: Path, data: Path, results: Sequence[Result]) -> None:
    """Write report.html and report.md from what has been measured so far."""
    clean, levels = [r for r in results if not r.get("noise")], sorted({r.get("noise", 0.0) for r in results} - {0.0})
    sections = [
        Section(table(clean), [*_decomposition(out, data, clean), *_horizon(clean)] if clean else ()),
        Section(fewer(clean), _amounts(clean)),
        *(Section(noisy([r for r in results if r.get("noise") == level], level), ()) for level in levels),
    ]
    sections = [section for section in sections if section.table.rows]
    number = f"{len(results)} models measured"
    with atomic_file(out / "report.html", "w") as file:
        file.write(html_page(number, sections, TITLE, COMMAND))
    with atomic_file(out / "report.md", "w") as file:
        file.write(f"# {TITLE}\n\n" + "\n".join(section.table.markdown() for section in sections))


def table(results: Sequence[Result]) -> Table:
    """Errors on the test characters, ours above the published ones."""
    rows = []
    for model, title in TITLES.items():
        found = _of(results, model)
        if not found:
            continue
        seconds = [r["seconds"] for r in found if r["seconds"] is not None]
        rows.append((title, *_errors(found), f"{max(seconds):.0f}" if seconds else "–", str(len(found))))
        if published := PUBLISHED.get(model):
            rows.append((f"{title}, published", *(f"{published[name]:.3g}" for name in MEASURES), "–", "10"))
    return Table(
        "Errors on the characters e, q and v",
        f"Mean over seeds and its {CONFIDENCE:.0%} interval (Student). {DIFFERENCES}",
        ("model", *MEASURES.values(), "training, s (slowest)", "seeds"),
        tuple(rows),
    )


def fewer(results: Sequence[Result]) -> Table:
    """Torque errors of models of fewer characters."""
    amounts = sorted({r["characters"] for r in results})
    rows = []
    for model, title in TITLES.items():
        of = {
            n: [r["scores"]["torque"] for r in results if (r["model"], r["characters"]) == (model, n)] for n in amounts
        }
        if any(of[n] for n in amounts if n != ALL):
            rows.append((title, *(f"{np.mean(of[n]):.2e}" if of[n] else "–" for n in amounts)))
    return Table(
        "Torque error against the number of characters",
        "(N m)², mean over seeds; of fewer characters, one of two or one in seven validates.",
        ("model", *(f"{n} characters" for n in amounts)),
        tuple(rows),
    )


def noisy(results: Sequence[Result], level: float) -> Table:
    """Errors of models that were learned from noisy positions."""
    of_models = ((title, _of(results, model)) for model, title in TITLES.items())
    return Table(
        f"Errors on the characters e, q and v, learned from positions with {level:.2g} of their spread as noise",
        "Velocities and accelerations were estimated; the test is without noise. Mean over seeds of both, "
        f"and its {CONFIDENCE:.0%} interval (Student).",
        ("model", *MEASURES.values(), "seeds"),
        tuple((title, *_errors(found), str(len(found))) for title, found in of_models if found),
    )


def interval(values: Sequence[float]) -> str:
    """Mean, and half the width of its confidence interval."""
    mean, number = float(np.mean(values)), len(values)
    if number < 2:
        return f"{mean:.3g}"
    half = stats.t.ppf((1 + CONFIDENCE) / 2, number - 1) * stats.sem(values)
    return f"{mean:.3g} ± {half:.1g}"


def _errors(found: Sequence[Result]) -> list[str]:
    """Of one model, a cell for each measure."""
    return [interval([r["scores"][name] for r in found]) for name in MEASURES]


def _of(results: Sequence[Result], model: str) -> list[Result]:
    return [r for r in results if r["model"] == model and r["characters"] == ALL]


def _decomposition(out: Path, data: Path, results: Sequence[Result]) -> Iterator[Picture]:
    """Parts of the torque of the first seed of each model beside the truth."""
    _, test = characters(data)
    q, v, a = (test.all(name) for name in ("q", "v", "a"))
    parts = ("inertial", "coriolis", "gravity")
    titles = [f"{part}, {joint}" for joint in test.joints for part in parts]
    figure = make_subplots(len(test.joints), len(parts), subplot_titles=titles, shared_xaxes=True)
    lines: list[tuple[str, Any, dict[str, Any]]] = [
        ("truth", {part: test.truth(part) for part in parts}, {"color": "#999", "width": 4})
    ]
    for colour, model in zip(COLOURS, TITLES, strict=False):
        if found := _of(results, model):
            decomposition = JointModel.load(out / "models" / f"{model}-{found[0]['seed']}").decompose(q, v, a)
            line = {"color": colour, "width": 1.2}
            lines.append((TITLES[model], {part: getattr(decomposition, part) for part in parts}, line))
    for name, values, line in lines:
        for j in range(len(test.joints)):
            for k, part in enumerate(parts):
                first = j == k == 0
                about = {"name": name, "legendgroup": name, "showlegend": first, "line": line}
                figure.add_scatter(y=values[part][:, j], row=j + 1, col=k + 1, **about)
    figure.update_yaxes(title="N m", col=1)
    title = "Parts of the torque on the characters e, v and q, sample by sample, first seed"
    yield figure_of(title, figure, 520, len(parts))


def _horizon(results: Sequence[Result]) -> Iterator[Picture]:
    """How long rollouts are valid, by character and seed."""
    figure = make_subplots(1, 1)
    for colour, model in zip(COLOURS, TITLES, strict=False):
        times = [t for r in _of(results, model) for t in r["scores"]["valid_times"]]
        if times:
            marker = {"color": colour}
            figure.add_box(y=times, name=TITLES[model], marker=marker, boxpoints="all", showlegend=False)
        if model in PUBLISHED:
            figure.add_scatter(
                x=[TITLES[model]], y=[PUBLISHED[model]["valid_time"]], mode="markers", name="published mean",
                marker={"symbol": "x", "color": "#333", "size": 10}, showlegend=model == "structured",
            )  # fmt: skip
    figure.update_yaxes(title="s", rangemode="tozero")
    yield figure_of("Valid rollouts, each of a character and a seed", figure)


def _amounts(results: Sequence[Result]) -> Iterator[Picture]:
    """Torque error against the number of characters."""
    figure = make_subplots(1, 1)
    for colour, model in zip(COLOURS, TITLES, strict=False):
        found = sorted((r["characters"], r["scores"]["torque"]) for r in results if r["model"] == model)
        amounts = sorted({n for n, _ in found})
        means = [float(np.mean([e for n, e in found if n == amount])) for amount in amounts]
        if len(amounts) > 1:
            figure.add_scatter(x=amounts, y=means, name=TITLES[model], line={"color": colour}, mode="lines+markers")
    figure.update_xaxes(title="characters", type="log")
    figure.update_yaxes(title="(N m)²", type="log", exponentformat="power")
    yield figure_of("Torque error on the test characters", figure)
