"""The look of a scene from frames: camera, visible lengths and blur, together with the pose of every frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from keycld_model.image_alignment.bank import Bank
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.look import CAMERA
from keycld_model.image_alignment.polish import best_blur, polished
from keycld_model.image_alignment.pose import FINEST, OUTLIER, TRUSTED, Pose, align, robust_weights
from keycld_model.image_alignment.scene import STEP, Scene, softened
from keycld_model.image_alignment.surroundings import Surroundings, Told

Array = NDArray[np.float64]
Image = NDArray[np.float32]
COARSE = (3.0, 3.0, 2.0, 1.0, 1.0)
"""Pixels by which images are softened in the first steps of Gauss-Newton on the look. Blur is not fitted yet: it would
stand for edges that are not yet in place."""
SHARP = (0.5, 0.5, 0.0, 0.0, 0.0)
"""And in the last ones, on the look and blur."""
STEPS = len(COARSE) + len(SHARP)
"""Steps, unless some poses turn out to have been wrong."""
ROUNDS = 3
"""Times that the last steps are gone at most: again where poses were wrong, or camera and lengths are not at rest."""
SETTLED = 0.05
"""Pixels that the last step of a look at rest moves what is seen, at most: no more than positions may be off."""
FEW = 0.1
"""Share of the frames whose poses may have been wrong, because they show little."""
WRONG = 0.1
"""Share of a frame's motion that another pose explains more: the first was wrong, and so may be the look."""
LONGEST = 2.0
"""Standard deviations expected of a parameter that a step changes it by at most."""
TRIED = 4
"""Positions of the bank from which a pose without a predecessor is fitted."""
MARKED = 2.4
"""Times that looks are farther off than frames seem to tell, where compression leaves marks on what is still: root mean
square of five films, .8 of eight without such marks (docs/notebook/2026-11-30-marks-and-bristles.md). A drawing then
fits alike a tenth of a pixel away."""
UNSEEN = 0.3
"""Frames of whose motion a pose explains a smaller share tell nothing of the look."""


@dataclass(frozen=True)
class Look:
    """How recordings look.

    Attributes:
        values: `[p]` of the scene's parameters.
        deviation: `[p]` their standard deviations, see `design_effect` and `MARKED`.
        lights: of each recording.
        bank: drawings with these values.
        best: of each recording, the pose that explains most of one of the frames that were fitted to.
    """

    values: Array
    deviation: Array
    lights: tuple[Light, ...]
    bank: Bank
    best: tuple[Pose, ...]

    @property
    def seen(self) -> bool:
        """Whether the mechanism was seen in any frame."""
        return any(pose.explained > UNSEEN for pose in self.best)


@dataclass(frozen=True)
class Sample:
    """A frame that the look is fitted to.

    Attributes:
        recording: index of its recording.
        frame: `[H, W, 3]`, 0 to 255.
        pose: its pose.
    """

    recording: int
    frame: Image
    pose: Pose

    @property
    def seen(self) -> bool:
        """Whether its pose explains so much that it tells something of the look."""
        return self.pose.explained > UNSEEN


def find_pose(scene: Scene, look: Array, light: Light, frame: Image, bank: Bank, still: Image) -> Pose:
    """Pose of a frame of which nothing else is known: the best fit from several positions of a bank."""
    starts = bank.nearest(frame, light, TRIED)
    poses = [align(scene, look, light, frame, still, start, near=False) for start in starts]
    return max(poses, key=lambda pose: pose.explained)


def fit_look(
    scene: Scene,
    stills: Sequence[Image],
    frames: Sequence[tuple[int, Image]],
    bank: Bank,
    surroundings: Surroundings,
    advance: Callable[..., None] | None = None,
) -> Look:
    """Fit the look of a scene.

    By Gauss-Newton; after the first sharp steps, the camera is told from what does not move, if that is drawn. Of
    compressed frames, blur and lengths are searched for at the end, see `polish`; and where what does not move bears
    marks of compression, the camera that it tells is kept if it leaves less of the frames.

    Args:
        scene: that draws.
        stills: of each recording, what it shows where nothing moves.
        frames: to fit to, each with the index of its recording.
        bank: drawings of the scene as the simulator has it.
        surroundings: what the recordings show where nothing moves.
        advance: called after each of the `STEPS`; not in rounds after them.
    """
    values, lights = scene.nominal, [Light.of(bank.still, still) for still in stills]
    samples = [
        Sample(r, f, find_pose(scene, values, lights[r], f, bank, lights[r].apply(bank.still))) for r, f in frames
    ]
    state = _State(values, np.full(len(values), np.inf), lights, bank, samples, np.inf)
    loose: Array | None = None
    doubtful: Told | None = None
    for turn, schedule in enumerate((COARSE, *[SHARP] * ROUNDS)):
        for soft in schedule:
            state = _stepped(scene, state, soft, loose, blur=loose is None and schedule is SHARP)
            if advance is not None and turn < 2:
                advance()
        q = [s.pose.q for s in state.samples]
        told, before = surroundings.camera(scene, state.values, q, loose) if turn else None, loose
        if told is not None and not told.exact:
            told, doubtful = None, told
        if told is not None:
            state = _with_camera(scene, state, told.look)
        state, moved = _again(scene, state)
        if told is not None:  # with another camera than that, poses explain little
            believed = np.median([s.pose.explained for s in state.samples if s.seen] or 0.0) >= TRUSTED
            loose = told.loose if believed else None
        freer = loose is not None and len(loose) > (0 if before is None else len(before))
        if turn and moved <= FEW and state.moves <= SETTLED and not freer:
            break
    if scene.compressed:
        state, left = _polished(scene, state, loose)
        if loose is None and doubtful is not None:
            other, less = _polished(scene, _from_camera(scene, state, doubtful), doubtful.loose)
            state = other if less < left else state
        if surroundings.marked(scene, state.values, [s.pose.q for s in state.samples]):
            state = state._replace(deviation=MARKED * state.deviation)
    of_each = [[s.pose for s in state.samples if s.recording == r] for r in range(len(stills))]
    best = tuple(max(poses, key=lambda pose: pose.explained) for poses in of_each)
    return Look(state.values, state.deviation, tuple(_lights(scene, state)), state.bank, best)


class _State(NamedTuple):
    """How far a fit is.

    Attributes:
        values: `[p]` of the scene's parameters.
        deviation: `[p]` their standard deviations.
        lights: of each recording.
        bank: drawings with the values of when poses were last looked for.
        samples: with their poses.
        moves: how far the last step of the camera and of visible lengths moves what is seen, pixels.
    """

    values: Array
    deviation: Array
    lights: Sequence[Light]
    bank: Bank
    samples: Sequence[Sample]
    moves: float


def _with_camera(scene: Scene, state: _State, look: Array) -> _State:
    """With another camera."""
    moves = STEP * np.abs((look - state.values) / scene.look_steps())[: len(CAMERA)]
    return state._replace(values=look, moves=max(state.moves, float(moves.max())))


def _from_camera(scene: Scene, state: _State, told: Told) -> _State:
    """With another camera, and what goes with it."""
    state, _ = _again(scene, _with_camera(scene, state, told.look))
    for soft in SHARP:
        state = _stepped(scene, state, soft, told.loose, blur=True)
    return _again(scene, state)[0]


def _polished(scene: Scene, state: _State, loose: Array | None) -> tuple[_State, float]:
    """With the blur, then the visible lengths and what still pixels do not tell of the camera, that leave the least.

    And the squares of grey levels that they leave of the frames.
    """
    lengths = np.diag(scene.look_steps())[[parameter.body is not None for parameter in scene.parameters]]
    directions = lengths if loose is None else np.concatenate([lengths, loose])
    if not any(s.seen for s in state.samples):
        return state, np.inf
    blur = best_blur(scene, state.values, _seen(scene, state))
    state, _ = _again(scene, state._replace(values=np.append(state.values[:-1], blur)))
    if not len(directions):
        return state, np.inf
    values, left = polished(scene, state.values, directions, _seen(scene, state))
    return _again(scene, state._replace(values=values))[0], left


def _seen(scene: Scene, state: _State) -> list[tuple[Image, Light, Array]]:
    """Frames that show the mechanism, with the light of their recordings, and its poses."""
    lights = _lights(scene, state)
    return [(s.frame, lights[s.recording], s.pose.q) for s in state.samples if s.seen]


def _stepped(scene: Scene, state: _State, soft: float, loose: Array | None, blur: bool) -> _State:
    """After a step of Gauss-Newton on images softened by so many pixels, on blur as well or not.

    If the camera was told, only on what still pixels do not tell of it.
    """
    values, samples = state.values, state.samples
    spread = np.array([p.spread for p in scene.parameters])
    lights = _lights(scene, state)
    parts = [_Linear.of(scene, values, lights[s.recording], s, soft) for s in samples]
    seen = [part for part, s in zip(parts, samples, strict=True) if s.seen] or parts
    normal = np.diag(1 / spread**2) + sum(part.normal for part in seen)
    gradient = sum(part.gradient for part in seen) - (values - scene.nominal) / spread**2
    free = _free(scene, samples, loose, blur)
    step = free.T @ np.linalg.solve(free @ normal @ free.T, free @ gradient)
    step *= LONGEST / max(LONGEST, float(np.abs(step / spread).max()))
    step[-1] = max(step[-1], -values[-1])
    samples = [_moved(s, part, step) for s, part in zip(samples, parts, strict=True)]
    known = np.diag(1 / spread**2) + sum(part.normal for part in seen) / design_effect([part.left for part in seen])
    deviation, moves = np.sqrt(np.diag(np.linalg.inv(known))), STEP * np.abs(step / scene.look_steps())
    return _State(values + step, deviation, lights, state.bank, samples, float(moves[:-1].max()))


def design_effect(left: Sequence[Array]) -> float:
    """Factor of the variance of what n frames tell, as they have in common some of what is left of them (Kish, 1965).

    It is 1 + (n - 1) r with the intraclass correlation r of pixels: what compression, thin lines and the steps of
    pixels do to a scene that stands still.

    Args:
        left: of each frame, `[pixels]`.
    """
    n, total = len(left), float(np.mean(np.square(left)))
    common = float(np.mean(np.mean(left, axis=0) ** 2))
    return max(1.0, n * common / max(total, 1e-30))  # 1 + (n - 1) r


def _free(scene: Scene, samples: Sequence[Sample], loose: Array | None, blur: bool) -> Array:
    """Directions `[k, p]` of a step; links that no pose explains yet would shrink until they do not disturb."""
    seen = any(s.seen for s in samples)
    free = np.array([loose is None if parameter.body is None else seen for parameter in scene.parameters])
    free[-1] = blur
    directions = np.eye(len(free))[free]
    return directions if loose is None else np.concatenate([directions, loose])


def _moved(sample: Sample, part: "_Linear", step: Array) -> Sample:
    """With the pose that goes with a step of the look."""
    return replace(sample, pose=replace(sample.pose, q=sample.pose.q + part.joints(step)))


def _again(scene: Scene, state: _State) -> tuple[_State, float]:
    """With drawings and poses in the look so far, and the share of the poses that turned out to be elsewhere.

    Those that explain less than the best one are looked for everywhere.
    """
    values, lights, samples = state.values, state.lights, state.samples
    bank = Bank(scene, values)
    stills = [light.apply(bank.still) for light in lights]
    near = [
        align(scene, values, lights[s.recording], s.frame, stills[s.recording], s.pose.q, near=True) for s in samples
    ]
    best, out = max(pose.explained for pose in near), []
    for s, pose in zip(samples, near, strict=True):
        found = pose
        if pose.explained < best - WRONG:
            other = find_pose(scene, values, lights[s.recording], s.frame, bank, stills[s.recording])
            found = other if other.explained > pose.explained + WRONG else pose
        out.append(replace(s, pose=found))
    moved = float(np.mean([s.pose is not pose for s, pose in zip(out, near, strict=True)]))
    return state._replace(bank=bank, samples=out), moved


def _lights(scene: Scene, state: _State) -> list[Light]:
    """Of each recording anew, where a sample shows it."""
    out, seen = list(state.lights), [s for s in state.samples if s.seen] or state.samples
    for r in range(len(out)):
        own = [s for s in seen if s.recording == r]
        if own:
            drawn = np.stack([scene.render(s.pose.q, state.values) for s in own])
            out[r] = Light.of(drawn, np.stack([s.frame for s in own]))
    return out


@dataclass(frozen=True)
class _Linear:
    """The difference between one frame and its drawing, to first order: y - A look - B joints, whitened.

    Attributes:
        left: `[pixels]` the difference, in robust standard deviations, no more than `OUTLIER` of them.
        normal: `[p, p]` of the look, joints and light eliminated.
        gradient: `[p]`.
        back: `[nq, p]` and `rest`: joints = rest - back look.
        rest: `[nq]`.
    """

    left: Array
    normal: Array
    gradient: Array
    back: Array
    rest: Array

    @classmethod
    def of(cls, scene: Scene, values: Array, light: Light, sample: Sample, soft: float) -> "_Linear":
        """About a look and a pose, of images softened by so many pixels."""
        q = sample.pose.q
        steps = (1 + soft) * scene.joint_steps(q, values)
        there = scene.render(q, values, soft)
        slopes = scene.look_jacobian(q, values, there, soft), scene.jacobian(q, values, steps, there, soft)
        of_look, of_joints = (
            (each.first * light.gain).reshape(len(each.first), -1).T.astype(np.float64) for each in slopes
        )
        bend = np.hypot(*((each.bend * light.gain).ravel().astype(np.float64) for each in slopes))
        drawn = light.apply(there)
        left = (softened(sample.frame, soft) - drawn).ravel().astype(np.float64)
        active = np.abs(of_joints).max(axis=1) >= 1e-3 * np.abs(of_joints).max()
        scale = max(FINEST, 1.4826 * float(np.median(np.abs(left[active]))))
        root = np.sqrt(robust_weights(left, scale)) / np.hypot(scale, bend)
        of_light = _light_columns(drawn)
        a, b, y = root[:, None] * of_look, root[:, None] * np.concatenate([of_joints, of_light], axis=1), root * left
        basis, triangle = np.linalg.qr(b)
        free = y - basis @ (basis.T @ y), a - basis @ (basis.T @ a)  # what neither pose nor light explains
        ridge = triangle + 1e-9 * np.abs(triangle).max() * np.eye(len(triangle))
        return cls(
            np.clip(left / scale, -OUTLIER, OUTLIER),
            free[1].T @ free[1],
            free[1].T @ free[0],
            np.linalg.solve(ridge, basis.T @ a)[: len(q)],
            np.linalg.solve(ridge, basis.T @ y)[: len(q)],
        )

    def joints(self, step: Array) -> Array:
        """Change of the joint positions that goes with a step of the look."""
        return self.rest - self.back @ step


def _light_columns(drawn: Image) -> Array:
    """Derivatives of an image to a factor and an offset of every colour, `[pixels, 6]`."""
    out = np.zeros((*drawn.shape, 6))
    for c in range(3):
        out[..., c, c], out[..., c, 3 + c] = drawn[..., c] / 100, 1.0
    return out.reshape(-1, 6)
