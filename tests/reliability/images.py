"""Images that show something else, in closed loops of all systems: python tests/reliability/images.py --seed 0.

For some steps of an episode the agent gets spoilt images. Counts whether it resumes and ends at the target, in how many
episodes a joint is faster than in undisturbed ones, and faster than where the mechanism falls from its target, too; and
the greatest speed of a joint, rad/s or m/s.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keycld_control.closed_loop import Loop, LoopSettings, make_loop
from keycld_envs import REFERENCE_SYSTEMS

Image = NDArray[np.uint8]
SPANS = ((0, 30), (20, 3), (15, 40), (35, 100), (10, 200), (25, 400))
"""First step with spoilt images, and their number."""
CLEAN = 6
"""Undisturbed episodes."""


def spoilers(rng: np.random.Generator, first: Image, other: Image) -> dict[str, Callable[[Image], Image]]:
    """What may come in place of an image, by name; "frozen" keeps the first one it is given."""
    held: list[Image] = []

    def frozen(image: Image) -> Image:
        held.append(image)
        return held[0]

    def patch(image: Image, rows: slice, columns: slice, value: int = 255) -> Image:
        out = image.copy()
        out[rows, columns] = value
        return out

    return {
        "black": np.zeros_like,
        "white": lambda image: np.full_like(image, 255),
        "noise": lambda image: rng.integers(0, 256, image.shape).astype(np.uint8),
        "white corner": lambda image: patch(image, slice(8), slice(8)),
        "white patch": lambda image: patch(image, slice(24, 40), slice(24, 40)),
        "half black": lambda image: patch(image, slice(None), slice(image.shape[1] // 2, None), 0),
        "inverted": lambda image: 255 - image,
        "upside down": lambda image: image[::-1].copy(),
        "shifted by 8 pixels": lambda image: np.roll(image, 8, axis=1),
        "mirrored": lambda image: image[:, ::-1].copy(),
        "frozen": frozen,
        "the first one again": lambda image: first,
        "another mechanism": lambda image: other,
    }


def episode(
    loop: Loop, seed: int, kind: str | None = None, span: tuple[int, int] = (0, 0), other: Image | None = None
) -> tuple[float, bool, int | None]:
    """Greatest joint speed, success, and steps after the last spoilt image until images are trusted again."""
    env, agent, (begin, length) = loop.env, loop.agent, span
    agent.reset()
    frame, info = env.reset(seed=seed)
    spoil = (
        None if kind is None else spoilers(np.random.default_rng(seed), frame, frame if other is None else other)[kind]
    )
    fastest, resumed = 0.0, None
    for step in range(loop.steps):
        spoilt = spoil is not None and begin <= step < begin + length
        action = agent.act(spoil(frame) if spoilt and spoil is not None else frame)
        if resumed is None and step >= begin + length and agent.trusted:
            resumed = step - begin - length
        frame, _, _, _, info = env.step(action)
        fastest = max(fastest, float(np.abs(env.data.qvel).max()))
    return fastest, bool(info["is_success"]), resumed


def fall(loop: Loop) -> float:
    """Greatest joint speed of the mechanism that is let go at its target."""
    loop.env.reset(options={"qpos": np.asarray(loop.env.system.target_qpos) + 0.01})
    fastest = 0.0
    for _ in range(loop.steps):
        loop.env.step(np.zeros(loop.env.model.nu))
        fastest = max(fastest, float(np.abs(loop.env.data.qvel).max()))
    return fastest


def run(seed: int, spans: Sequence[int], only: str | None = None) -> list[dict[str, Any]]:
    """One row per system, of all or one, and kind of image."""
    rows: list[dict[str, Any]] = []
    first = {}
    for name in REFERENCE_SYSTEMS:
        with make_loop(LoopSettings(name)) as loop:
            first[name] = loop.env.reset(seed=seed)[0].copy()
    for i, name in enumerate(REFERENCE_SYSTEMS):
        if only not in (None, name):
            continue
        other = first[REFERENCE_SYSTEMS[(i + 1) % len(REFERENCE_SYSTEMS)]]
        with make_loop(LoopSettings(name, start="random")) as loop:
            clean = max(episode(loop, 1000 * seed + 100 + k)[0] for k in range(CLEAN))
            passive = fall(loop)
            for kind in spoilers(np.random.default_rng(0), other, other):
                done = [episode(loop, 1000 * seed + 200 + k, kind, SPANS[k], other) for k in spans]
                rows.append(
                    {
                        "system": name,
                        "images": kind,
                        "episodes": len(done),
                        "resumed": sum(d[2] is not None for d in done),
                        "at the target": sum(d[1] for d in done),
                        "faster than undisturbed": sum(d[0] > clean for d in done),
                        "faster than falling, too": sum(d[0] > max(clean, passive) for d in done),
                        "greatest speed": round(max(d[0] for d in done), 2),
                        "undisturbed": round(clean, 2),
                        "falling": round(passive, 2),
                    }
                )
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--span", type=int, action="append", help="which of the times with spoilt images; all if none")
    parser.add_argument("--system", choices=REFERENCE_SYSTEMS)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    table = run(given.seed, given.span or range(len(SPANS)), given.system)
    if given.json:
        print(json.dumps(table))
    else:
        counted = ("episodes", "resumed", "at the target", "faster than undisturbed", "faster than falling, too")
        total = {"system": "all", "images": "all"} | {name: sum(row[name] for row in table) for name in counted}
        table.append({name: total.get(name, "") for name in table[0]})
        print("| " + " | ".join(table[0]) + " |\n" + "|---" * len(table[0]) + "|")
        for row in table:
            print("| " + " | ".join(map(str, row.values())) + " |")
