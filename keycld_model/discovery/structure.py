"""Which parts, on which joints: candidates ranked by how they predict held-out frames, at a price for freedom."""

from dataclasses import dataclass, replace

import numpy as np

from keycld_envs.progress import Advance
from keycld_model.discovery.frames import Frames
from keycld_model.discovery.parts import Part, Placed, chart_of, placed, size_of
from keycld_model.discovery.search import Candidate, candidates
from keycld_model.discovery.shapes import Alternation, resampled

PRICE = 0.05
"""Share of the squared error of everything that moves, that each degree of freedom has to explain in held-out frames.
What the cartpole's frames show of shadow and reflection explains .033 as a further part."""
MOST_PARTS = 5
ALTERNATIVES = 1
"""Other joints of each part that are ranked beside the best."""
TOGETHER_ANGLE, TOGETHER_PIXELS = 0.12, 1.0
"""rad, pixels; median by which a part's motion differs from another's, or from its mirror image, below which it is no
part of its own: a shadow, a reflection, or more of the same part."""
LOOSE = 2.0
"""Pixels by which a joint is let loose at most, to see whether it holds."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Parts on joints, and what speaks for them.

    Attributes:
        parts: each after its parent.
        unexplained: share of the squared error of everything that moves, in held-out frames.
        freedom: degrees of freedom.
        loose: indices of parts whose joint does not hold them.
    """

    parts: tuple[Part, ...]
    unexplained: float
    freedom: int
    loose: tuple[int, ...] = ()

    @property
    def score(self) -> float:
        """What is unexplained, and the price of what explains it; less is better."""
        return self.unexplained + PRICE * self.freedom

    @property
    def name(self) -> str:
        """Its joints, in words."""
        words = []
        for k, part in enumerate(self.parts):
            on = "ground" if part.joint.parent is None else f"part {part.joint.parent}"
            loose = " let loose" * (k in self.loose)
            words.append(f"{part.joint.kind} on {on}{loose}")
        return ", ".join(words) or "nothing moves"


@dataclass(frozen=True, eq=False)
class Discovery:
    """What was found.

    Attributes:
        best: the structure with the least score.
        ranked: all that were compared, the best first.
        frames: from which they were found.
        fitted: the best structure's parts in the frames of which they were learned.
        held_out: and in those held out.
        followers: the parts with which something moves that was not taken for a part of its own.
    """

    best: Structure
    ranked: tuple[Structure, ...]
    frames: Frames
    fitted: Placed
    held_out: Placed
    followers: tuple[int, ...] = ()


def discover(frames: Frames, advance: Advance) -> Discovery:
    """Add parts as long as each pays for itself, then let every joint loose.

    Args:
        frames: of recordings.
        advance: a progress bar, of `steps()` steps at most.
    """
    now = Placed.nothing(frames.fitted, frames.background)
    empty = Placed.nothing(frames.held_out, frames.background)
    moving = float(empty.unexplained.sum())
    best, ranked = Structure((), 1.0, 0), [Structure((), 1.0, 0)]
    followers: list[int] = []
    for _ in range(MOST_PARTS):
        offered = []
        for candidate in candidates(now)[: 1 + ALTERNATIVES]:
            more = _added(now, candidate)
            if not all(part.points.size and fit.total > 0 for part, fit in zip(more.parts, more.fits, strict=True)):
                continue  # nothing there, or all of another part
            leader = _follows(more)
            if leader is not None:
                followers.append(leader)
                continue
            offered.append((_judged(frames, more.parts, moving), more))
        ranked += [structure for structure, _ in offered]
        advance()
        if not offered:
            break
        structure, more = min(offered, key=lambda pair: pair[0].score)
        if structure.score >= best.score:
            break
        best, now = structure, more
    held_out = placed(frames.held_out, frames.background, now.parts)
    for k in range(len(now.parts)):
        loose = _loosened(held_out, best, k, moving)
        ranked.append(loose)
        advance()
    ranked.sort(key=lambda each: each.score)
    return Discovery(best, tuple(ranked), frames, now, held_out, tuple(followers))


def steps() -> int:
    """The most steps that `discover` makes."""
    return 2 * MOST_PARTS


def _added(now: Placed, candidate: Candidate) -> Placed:
    """One part more, learned from all frames, and all parts placed and learned anew."""
    joint = candidate.joint
    chart = chart_of(joint, now.parent(joint), size_of(joint, now.images.shape[1:3]))
    shape = resampled(candidate.fit.shape, candidate.chart, chart, candidate.reduction)
    fit = Alternation(now.stack(), chart).refine(shape)
    return now.with_part(joint, fit, chart.size).swept(learn=True)


def _judged(frames: Frames, parts: tuple[Part, ...], moving: float) -> Structure:
    """A structure by the frames held out."""
    left = float(placed(frames.held_out, frames.background, parts).unexplained.sum())
    return Structure(parts, left / moving, len(parts))


def _follows(now: Placed) -> int | None:
    """The part that the last one moves with, or mirrors, and is thus no part of its own; None if there is none."""
    seen = now.fits[-1].gain > 0
    for k in range(len(now.parts) - 1):
        both = seen & (now.fits[k].gain > 0)
        if both.sum() > 3 and _together(now, k, both):
            return k
    return None


def _together(now: Placed, k: int, both: np.ndarray) -> bool:
    one, other = now.parts[k].joint, now.parts[-1].joint
    a, b = now.fits[k].shift[both], now.fits[-1].shift[both]
    if one.kind != other.kind:
        return False
    if one.kind == "slide":
        slope, offset = np.polyfit(a, b, 1)
        return bool(np.median(np.abs(b - slope * a - offset)) < TOGETHER_PIXELS < np.std(b))
    off = [
        float(np.median(np.abs(np.angle(turn / turn.mean())))) for turn in (np.exp(1j * (b - a)), np.exp(1j * (b + a)))
    ]
    return min(off) < TOGETHER_ANGLE < float(np.std(np.angle(np.exp(1j * (b - np.angle(np.exp(1j * b).mean()))))))


def _loosened(now: Placed, best: Structure, k: int, moving: float) -> Structure:
    """The structure with one joint let loose: its place may differ from frame to frame, across a rail alone."""
    part = now.parts[k]
    chart, stack = chart_of(part.joint, now.parent(part.joint), part.size), now.stack(without=k)
    offsets = np.arange(-LOOSE, LOOSE + 1)
    if chart.along is None:
        moves = [np.array([[dx, dy]]) for dx in offsets for dy in offsets]
    else:
        moves = [d * np.stack([-chart.along[:, 1], chart.along[:, 0]], axis=-1) for d in offsets]
    held = Alternation(stack, chart).place(part.shape).gain
    gains = [Alternation(stack, replace(chart, origin=chart.origin + move)).place(part.shape).gain for move in moves]
    more = float((np.max(gains, axis=0) - held).sum())
    freedom = best.freedom + (2 if chart.along is None else 1)
    return Structure(best.parts, best.unexplained - more / moving, freedom, (k,))
