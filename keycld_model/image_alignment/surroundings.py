"""The camera, told from what does not move: the mean of all frames has next to no noise.

A drawing changes in small steps when the camera moves, so that fits by derivatives end in a step nearby, a tenth of a
pixel off. What is still is compared without derivatives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from cmaes import CMA
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.ndimage import binary_dilation
from scipy.special import huber
from scipy.stats import norm

from keycld_model.image_alignment.light import WHITE, Light
from keycld_model.image_alignment.look import CAMERA, PARALLAX, view_of
from keycld_model.image_alignment.scene import STEP, Scene, softened
from keycld_model.image_alignment.simplex import least_near

Array = NDArray[np.float64]
Image = NDArray[np.float32]
SAMPLED = 200
"""Frames of a recording, or up to twice as many, that tell where something moves."""
RESTLESS = 1.5
"""A pixel has moved if its standard deviation over time is that of the noise so many times, and a grey level more."""
AROUND = 2
"""Pixels around those that have moved that are left out, too: blur carries motion there."""
CLIPPED = 0.5
"""Standard deviations of noise, and a grey level, beyond black or white, up to which what is cut off is told from the
mean: of what is darker by more, less than a fifth of a standard deviation is left in it."""
LEAST_STILL = 0.2
"""Share of the pixels that must be still."""
FLAT = 1.0
"""Misfit of still pixels to one colour, squares of grey levels, below which nothing is to be seen in them."""
NOISE = 3.0
"""Times the noise of the mean, and the rounding of a drawing, that the drawing may leave; with more, the surroundings
are not the simulator's, or compression leaves its marks on them, by which a camera is not told as exactly."""
MARKS = 0.02
"""Share of what is to be seen in still pixels that such marks may be; with more, they are not the simulator's."""
ROUGH = 0.0035
"""By how much more than the least misfit a search may end, squares of grey levels: the most of 24 cameras."""
TELLING = 0.1
"""Pixels by which a camera that ends so may shift or enlarge the mechanism; what may do more is left to the mechanism,
whose own fit to some frames is off by about as much."""
RIGHT, UP, ZOOM = MOVES = tuple(CAMERA.index(name) for name in ("right", "up", "zoom"))
"""Where they are among the parameters that move a mechanism in the image."""
ROUNDED = 1 / 12
"""Variance of rounding to whole grey levels."""
OUTLIER = 3.0
"""Grey levels beyond which a difference counts linearly: what passed by is left in a mean."""
REACHES = ((1.5, 1.0, 72), (0.0, 0.3, 36))
"""Of populations, one after the other: pixels by which images are softened; the standard deviation of the first looks,
in steps of finite differences: .7 pixels, then .2; and the number of looks of a generation, six and three times what is
usual for eleven numbers, for the misfit is rough: of 36, three of eight populations ended far from the camera of a
cartpole, of 72 none (docs/notebook/2026-11-30-fast-and-dark-films.md)."""
GENERATIONS = 80
"""Of a population."""
POLISH = (0.3, -0.15)
"""First steps of the simplex searches after it, in steps of finite differences."""
EVALUATIONS = 300
"""Drawings of such a search, at most."""


class Told(NamedTuple):
    """What still pixels tell of a look.

    Attributes:
        look: `[p]`.
        loose: `[k, p]` directions in which they do not tell it: where nothing near the mechanism is still, it may be
            shifted or larger if the camera stands elsewhere.
        exact: the drawing leaves no more than noise.
    """

    look: Array
    loose: Array
    exact: bool


class _StillPixels(NamedTuple):
    """What several recordings have in common, in the light of the drawing.

    Attributes:
        where: `[H, W]` they are.
        shown: `[H, W, 3]` the mean of the recordings.
        noise: the most that noise leaves of them, squares of grey levels.
    """

    where: NDArray[np.bool_]
    shown: Image
    noise: float

    @property
    def visible(self) -> float:
        """Misfit of one colour to them, squares of grey levels."""
        shown = self.shown[self.where]
        return _misfit(np.zeros_like(shown), shown)


@dataclass(frozen=True)
class Surroundings:
    """What recordings show where nothing moves.

    Attributes:
        mean: of each recording, `[H, W, 3]` of its frames as if no noise were cut off at black and white, grey levels.
        noise: of each recording, standard deviation of the noise in a frame, grey levels.
        frames: of each recording, how many there are.
        still: `[H, W]` where nothing moves in any of them.
    """

    mean: tuple[Image, ...]
    noise: tuple[float, ...]
    frames: tuple[int, ...]
    still: NDArray[np.bool_]

    @classmethod
    def of(cls, films: Sequence[NDArray[np.uint8]]) -> Self:
        """Of recordings' frames `[T, H, W, 3]`."""
        means, noise, moved = [], [], np.zeros(films[0].shape[1:3], bool)
        for frames in films:
            some = frames[:: max(1, len(frames) // SAMPLED)]  # all as real numbers may be gigabytes
            spread = some.std(axis=0, dtype=np.float32).max(axis=-1)
            usual = float(np.median(spread))
            noise.append(usual)
            means.append(unclipped(frames.mean(axis=0, dtype=np.float32), usual))
            moved |= spread > RESTLESS * usual + 1
        return cls(tuple(means), tuple(noise), tuple(map(len, films)), ~_widened(moved))

    def camera(self, scene: Scene, look: Array, drawn_at: Sequence[Array], loose: Array | None = None) -> Told | None:
        """The look with the camera and the blur with which still pixels are drawn as they are seen.

        Args:
            scene: that draws.
            look: `[p]`, off by two pixels at most.
            drawn_at: positions `[nq]` of the mechanism in some frames.
            loose: the look is one that was found here before, with other positions, and in these directions `[k, p]`
                told by the mechanism; it stays there.

        Returns:
            None where too little is still, or it is not the simulator's.
        """
        pixels = self._still_pixels(scene, look, drawn_at)
        if pixels is None or (visible := pixels.visible) < FLAT:
            return None
        steps = _searched(scene.look_steps(), loose)

        def misfit(soft: float) -> Callable[[Array], float]:
            of_still = _among(pixels.where, soft)
            there = of_still(pixels.shown)
            return lambda look: _misfit(of_still(scene.render(drawn_at[0], look)), there)

        for soft, reach, looks in REACHES if loose is None else ():
            look = _roughly(misfit(soft), look, steps, reach, looks)
        sharp = misfit(0.0)
        best, left = _polished(sharp, look, steps)
        exact = left < pixels.noise
        if not exact and left > MARKS * visible:
            return None
        return Told(best, _loose(scene, best, drawn_at[0], pixels.where), exact)

    def marked(self, scene: Scene, look: Array, drawn_at: Sequence[Array]) -> bool:
        """Whether a drawing with a look leaves more of still pixels than noise, see `camera`."""
        pixels = self._still_pixels(scene, look, drawn_at)
        if pixels is None:
            return False
        drawn = scene.render(drawn_at[0], look)[pixels.where]
        return _misfit(drawn, pixels.shown[pixels.where]) >= pixels.noise

    def _still_pixels(self, scene: Scene, look: Array, drawn_at: Sequence[Array]) -> "_StillPixels | None":
        """What the recordings have in common; None where too little is still."""
        drawn = np.stack([scene.render(q, look) for q in drawn_at])
        moved = (drawn.max(axis=0) - drawn.min(axis=0)).max(axis=-1) > 1
        still, usual = self.still & ~_widened(moved), drawn.mean(axis=0)
        if still.mean() < LEAST_STILL:
            return None
        lights = [Light.of(usual[still], mean[still]) for mean in self.mean]
        still &= ~self._black_or_white(usual, lights)
        if still.mean() < LEAST_STILL:
            return None
        seen = [(mean - light.offset) / light.gain for mean, light in zip(self.mean, lights, strict=True)]
        of_mean = [n**2 / count for n, count in zip(self.noise, self.frames, strict=True)]
        noise = np.mean([n / np.mean(light.gain) ** 2 for n, light in zip(of_mean, lights, strict=True)])
        shown = np.asarray(np.mean(seen, axis=0), np.float32)
        return _StillPixels(still, shown, NOISE * (float(noise) / len(lights) + ROUNDED))

    def _black_or_white(self, drawn: Image, lights: Sequence[Light]) -> NDArray[np.bool_]:
        """Pixels `[H, W]` that are black or white, however much darker or brighter what they show is."""
        out = np.zeros(drawn.shape[:2], bool)
        for mean, noise, light in zip(self.mean, self.noise, lights, strict=True):
            beyond = 1 + CLIPPED * noise
            seen = drawn * light.gain + light.offset
            out |= ((np.minimum(mean, seen) < -beyond) | (np.maximum(mean, seen) > WHITE + beyond)).any(axis=-1)
        return out


def unclipped(mean: Image, noise: float) -> Image:
    """What pixels show, told from their mean over frames whose noise was cut off at black and white.

    The mean of a normal variable that is cut off at zero, in standard deviations, is φ(z) + z Φ(z) (Tobin, 1958).

    Args:
        mean: of frames, 0 to 255.
        noise: standard deviation of a frame's, grey levels.

    Returns:
        As far as that can be told: twice `CLIPPED` standard deviations beyond black and white at most.
    """
    z = np.linspace(-2 * CLIPPED, 4.0, 200)
    cut_off = noise * (norm.pdf(z) + z * norm.cdf(z))

    def restored(level: Image) -> Image:
        return np.where(level < noise * z[-1], np.interp(level, cut_off, noise * z), level).astype(np.float32)

    return WHITE - restored(WHITE - restored(mean))


def _loose(scene: Scene, look: Array, q: Array, still: NDArray[np.bool_]) -> Array:
    """Directions `[k, p]` in which a mechanism moves or grows by a pixel, and still pixels do not tell.

    There are none for orthographic cameras, to which nothing is far away.
    """
    if not np.isfinite(scene.focal):
        return np.zeros((0, len(look)))
    after, before = (_far_in_place(scene, look, side) for side in (1.0, -1.0))
    pairs = zip(after, before, strict=True)
    changes = [np.float32(0.5) * (scene.render(q, there) - scene.render(q, back))[still] for there, back in pairs]
    rises, of_ways = np.linalg.eigh(_rises(scene.render(q, look)[still], changes))
    return (of_ways.T @ ((np.array(after) - before) / 2))[rises < ROUGH / TELLING**2]


def _far_in_place(scene: Scene, look: Array, pixels: float) -> list[Array]:
    """Looks `[p]` in which the mechanism is shifted or larger by some pixels, and what is far away stays in place."""
    out, step = [], scene.look_steps() / STEP * pixels
    for k in MOVES:
        there = look + step * (np.arange(len(look)) == k)
        view = view_of(look).far_in_place(there[RIGHT], there[UP], float(np.exp(there[ZOOM])), scene.focal)
        there[[CAMERA.index(name) for name in PARALLAX]] = view.aside, view.above, view.nearer
        out.append(there)
    return out


def _searched(steps: Array, loose: Array | None) -> Array:
    """Steps `[n, p]` of the camera and of blur, of finite differences `[p]`, in all directions but loose ones."""
    free = np.array([*range(len(CAMERA)), len(steps) - 1])
    out = np.zeros((len(free), len(steps)))
    out[np.arange(len(free)), free] = steps[free]
    return out if loose is None or not len(loose) else null_space(loose[:, free] / steps[free]).T @ out


def _among(still: NDArray[np.bool_], soft: float) -> Callable[[Image], Image]:
    """What takes still pixels `[pixels, 3]` out of an image, softened among themselves."""
    if not soft:
        return lambda image: image[still]
    weight = still.astype(np.float32)[..., None]
    total = np.maximum(softened(weight, soft), np.float32(1e-6))[still]
    return lambda image: np.asarray(softened(image * weight, soft)[still] / total, np.float32)


def _moved(look: Array, z: Array, steps: Array) -> Array:
    """A look moved by multiples of steps `[k, p]`; blur is not negative."""
    there = look + z @ steps
    return np.append(there[:-1], max(0.0, there[-1]))


def _roughly(misfit: Callable[[Array], float], look: Array, steps: Array, reach: float, looks: int) -> Array:
    """A look `[p]` with a small misfit, near another, or that one.

    There are steps in the misfit, so that methods that go downhill end beside the least one; a population does not
    (CMA-ES; Hansen and Ostermeier, 2001).
    """
    population = CMA(np.zeros(len(steps)), reach, population_size=looks, seed=0)
    for _ in range(GENERATIONS):
        some = [population.ask() for _ in range(looks)]
        population.tell([(z, misfit(_moved(look, z, steps))) for z in some])
    return min((look, _moved(look, population.mean, steps)), key=misfit)


def _polished(misfit: Callable[[Array], float], look: Array, steps: Array) -> tuple[Array, float]:
    """A look with the least misfit nearby, and that misfit."""
    best, least = least_near(
        lambda z: misfit(_moved(look, z, steps)), len(steps), POLISH, EVALUATIONS, exact=0.002, flat=1e-4
    )
    return _moved(look, best, steps), least


def _widened(moved: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """With the pixels around."""
    return np.asarray(binary_dilation(moved, iterations=AROUND), bool)


def _rises(drawn: Image, changes: Sequence[Image]) -> Array:
    """Quadratic form `[k, k]` by which the misfit of still pixels `[pixels, 3]` rises with changes, in any light."""
    x = drawn - drawn.mean(axis=0)
    steady = x / np.maximum(np.linalg.norm(x, axis=0), 1e-9)
    out = []
    for change in changes:
        free = change - change.mean(axis=0)
        out.append((free - steady * np.sum(steady * free, axis=0)).ravel())
    return np.asarray(np.inner(out, out), np.float64) / drawn.size


def _misfit(drawn: Image, shown: Image) -> float:
    """Mean square of what is shown and not drawn, `[pixels, 3]`, in any light; large differences count linearly."""
    x, y = drawn - drawn.mean(axis=0), shown - shown.mean(axis=0)
    gain = np.sum(x * y, axis=0) / np.maximum(np.sum(x**2, axis=0), 1e-9)
    return float(2 * np.mean(huber(OUTLIER, y - gain * x)))
