"""Stage 1, continued: a keypoint that explains less than what no keypoint explains is moved to where that is.

Keypoints start where a frame differs most from the mean frame, and a part of few pixels is easily left without one
while two keypoints follow a larger part. As in vector quantisation, where a code that hardly stands for anything is put
where the error is largest (Linde, Buzo, Gray 1980), such a keypoint is taught where images are drawn worst, and
discovery goes on from there.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from keycld_model.modules import Parts, as_float
from keycld_model.nets.estimator import blur
from keycld_model.nets.hourglass import grid
from keycld_model.redundancy import told_by_others
from keycld_model.training.data import TrainingData
from keycld_model.training.discover import Discover, constraint_variance
from keycld_model.training.stage import Batch, Context, Stage, Variables

SAMPLE = 512
"""Frames from which it is told what keypoints explain."""
TAUGHT = 4000
"""Frames, at most, in which the place of a moved keypoint is taught."""
SHARPNESS = 20.0
"""Of the softmax over the blurred error, whose largest value is 1, that tells where images are drawn worst."""
REACH = 5
"""Pixels, half of what the error is averaged over each way."""
BENT = 0.1
"""Image units by which rods and sliders may vary (standard deviation) where a keypoint is moved to: places at which
images are drawn worst are within a few hundredths of the part; a place that varies by more is not on one."""
CHUNK = 64
"""Frames drawn at once."""


class Unexplained(NamedTuple):
    """What images show and keypoints do not draw, `B` frames.

    Attributes:
        keypoints: [B, n].
        error: [B] squared error, summed over pixels and channels.
        place: [B, 2] where it is largest, image units.
        there: [B] squared error around that place beyond what the image has everywhere, for instance noise.
    """

    keypoints: NDArray[np.float32]
    error: NDArray[np.float32]
    place: NDArray[np.float32]
    there: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Relocate(Stage):
    """Teach the estimator another place for the keypoint that explains least, and the same for the others."""

    name: str = "relocate"
    trained: tuple[str, ...] = ("estimator",)
    optional: ClassVar[bool] = True

    def needed(self, parts: Parts, variables: Variables, data: TrainingData) -> bool:
        """Whether a keypoint explains less than what no keypoint explains."""
        return spare_keypoint(parts, variables, data) is not None

    def enter(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Remember where keypoints are to be."""
        spare = spare_keypoint(parts, variables, data)
        there = unexplained(parts, variables, data.flat_frames[data.spread(TAUGHT)])
        places = there.keypoints.reshape(len(there.place), -1, 2).copy()
        if spare is not None:
            places[:, spare] = there.place
        return {**variables, "places": jnp.asarray(places.reshape(len(places), -1))}

    def prepare(self, parts: Parts, variables: Variables, data: TrainingData) -> Context:
        """The frames that are taught, and the places in them."""
        return {"frames": data.spread(TAUGHT), "places": np.asarray(variables["places"])}

    def draw(self, context: Context, data: TrainingData, rng: np.random.Generator) -> Batch:
        """Frames from anywhere."""
        i = rng.integers(0, len(context["frames"]), self.batch)
        return {"frames": data.flat_frames[context["frames"][i]], "places": context["places"][i]}

    def loss(self, parts: Parts, variables: Variables, batch: Batch) -> tuple[Array, dict[str, Array]]:
        """Mean distance to the places, image units."""
        x = parts.keypoints(variables, as_float(batch["frames"]))
        error = (x - batch["places"]).reshape(x.shape[0], -1, 2)
        distance = jnp.mean(jnp.sqrt(jnp.sum(error**2, axis=-1) + 1e-6))
        return distance, {"distance": distance, "keypoint_spread": jnp.std(x, 0)}

    def leave(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """Tell discovery that a keypoint has moved."""
        rest = {name: value for name, value in variables.items() if name != "places"}
        return {**rest, "relocated": jnp.ones(())}


@dataclass(frozen=True, kw_only=True)
class Rediscover(Discover):
    """Discovery from where a keypoint was moved to; nothing if none was."""

    name: str = "discover again"
    optional: ClassVar[bool] = True

    def needed(self, parts: Parts, variables: Variables, data: TrainingData) -> bool:
        """Whether a keypoint was moved."""
        return "relocated" in variables

    def leave(self, parts: Parts, variables: Variables, data: TrainingData) -> Variables:
        """As if it had been found at once."""
        return {name: value for name, value in variables.items() if name != "relocated"}


def spare_keypoint(parts: Parts, variables: Variables, data: TrainingData) -> int | None:
    """A keypoint that adds less to the others than one elsewhere, where its rods allow, could; None if there is none.

    A keypoint adds what drawing gets worse by if it is where the others say (linear regression): nothing, if it rides
    on the same part as another one. Of two that do, the one is taken whose rods and sliders fit the other place better.
    """
    frames = data.flat_frames[data.spread(SAMPLE)]
    seen = unexplained(parts, variables, frames)
    misfit: dict[int, float] = {}
    for k in range(parts.config.mechanism.num_keypoints):
        told = told_by_others(seen.keypoints, k)
        if np.mean(unexplained(parts, variables, frames, told).error - seen.error) < np.mean(seen.there):
            moved = seen.keypoints.copy()
            moved[:, 2 * k : 2 * k + 2] = seen.place
            misfit[k] = float(constraint_variance(parts, variables, jnp.asarray(moved)))
    misfit = {k: variance for k, variance in misfit.items() if variance < BENT**2}
    return min(misfit, key=misfit.__getitem__, default=None)


def unexplained(
    parts: Parts, variables: Variables, frames: NDArray[np.uint8], keypoints: NDArray[np.float32] | None = None
) -> Unexplained:
    """What drawing leaves of frames `[B, H, W, 3]`, from their own keypoints or others `[B, n]`."""
    needed: dict[str, Any] = {name: variables[name] for name in ("estimator", "renderer", "dynamics")}
    rows = []
    for i in range(0, len(frames), CHUNK):
        given = None if keypoints is None else jnp.asarray(keypoints[i : i + CHUNK])
        rows.append(jax.tree.map(np.asarray, _look(parts, needed, jnp.asarray(frames[i : i + CHUNK]), given)))
    return Unexplained(*(np.concatenate(column) for column in zip(*rows, strict=True)))


@partial(jax.jit, static_argnames="parts")
def _look(parts: Parts, variables: Variables, images: Array, keypoints: Array | None) -> tuple[Array, ...]:
    """The fields of `Unexplained`."""
    images = as_float(images)
    x = parts.keypoints(variables, images) if keypoints is None else keypoints
    error = jnp.sum((parts.render(variables, x) - images) ** 2, axis=-1, keepdims=True)
    everywhere = jnp.median(error, axis=(1, 2), keepdims=True)
    near = blur(error - everywhere, REACH)
    there = jnp.max(near, axis=(1, 2, 3))
    relative = near / (there[:, None, None, None] + 1e-9)
    weight = jax.nn.softmax(SHARPNESS * relative.reshape(len(x), -1), axis=1)
    place = weight @ grid(error.shape[1], error.shape[2], 1).reshape(-1, 2)
    return x, jnp.sum(error, axis=(1, 2, 3)), place, REACH**2 * there  # all of it, if it is in one pixel
