"""Keypoints of drawn mechanisms as a trained estimator sees them, without its images: noise, and errors by the pose."""

from dataclasses import dataclass
from itertools import combinations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_control.benchmarks.intervals.truth import Truth
from keycld_envs import Mechanism
from keycld_model.config import ModelConfig
from keycld_model.modules import Parts
from keycld_model.places import carried, is_joint
from keycld_model.training.stage import Variables

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Errors:
    """Errors of an estimator of keypoints, image units; the defaults are the shipped weights', see docs/model.md.

    Attributes:
        noise: standard deviation of what goes with nothing but time.
        correlation: share of the noise that lasts.
        memory: correlation of that share from frame to frame.
        offset: of a constant error of each coordinate.
        harmonic: of the amplitude of each harmonic of the rods' angles.
        order: highest harmonic.
        link: of how much longer a rod between two joints looks, as a share; what is seen is nearer than the joints.
        cart: of how much longer ways along a rail look.
    """

    noise: float = 0.002
    correlation: float = 0.5
    memory: float = 0.8
    offset: float = 0.0015
    harmonic: float = 0.0003
    order: int = 3
    link: float = 0.004
    cart: float = 0.015

    def draw(self, truth: Truth, x: Array, rng: np.random.Generator) -> Array:
        """`[N, T, n]` for point masses at `[N, T, K, 2]`."""
        angles, coordinates = rod_angles(truth, x), 2 * x.shape[2]
        count, length, rods = angles.shape
        pose = rng.normal(scale=self.offset, size=coordinates) * np.ones((count, length, 1))
        orders = range(-self.order, self.order + 1)
        for multiple in np.stack(np.meshgrid(*[orders] * rods), -1).reshape(-1, rods):
            if 0 < np.abs(multiple).sum() <= self.order:
                phase = rng.uniform(-np.pi, np.pi, coordinates)
                size = rng.normal(scale=self.harmonic, size=coordinates)
                pose = pose + size * np.sin((angles @ multiple)[..., None] + phase)
        white, lasting = rng.normal(size=(2, count, length, coordinates))
        for t in range(1, length):
            fresh = np.sqrt(1 - self.memory**2) * lasting[:, t]
            lasting[:, t] = self.memory * lasting[:, t - 1] + fresh
        share = self.correlation
        noise = self.noise * (np.sqrt(1 - share) * white + np.sqrt(share) * lasting)
        return pose + noise + self._larger(truth.system.mechanism, x, rng).reshape(pose.shape)

    def _larger(self, mechanism: Mechanism, x: Array, rng: np.random.Generator) -> Array:
        """`[N, T, K, 2]` of parts that look larger, with all that they carry."""
        out = np.zeros_like(x)
        for slider in mechanism.sliders:
            way = (x[:, :, slider.keypoint] - mechanism.pivot) @ slider.along
            far = self.cart * rng.normal() * way[..., None] * slider.along
            out[:, :, list(carried(mechanism, slider.keypoint))] += far[:, :, None]
        for rod in mechanism.rods:
            if not is_joint(mechanism, rod.end):
                continue
            reach = x[:, :, rod.end] - (mechanism.pivot if rod.start is None else x[:, :, rod.start])
            out[:, :, list(carried(mechanism, rod.end))] += (self.link * rng.normal() * reach)[:, :, None]
        return out


@dataclass(frozen=True)
class Motion:
    """Recordings of a simulated mechanism.

    Attributes:
        qpos: `[N, T, nq]`.
        actions: `[N, T-1, m]`.
    """

    qpos: Array
    actions: Array


def simulate(truth: Truth, count: int, length: int, rng: np.random.Generator) -> Motion:
    """Random starts at rest, one constant action each, none in a fifth: what `keycld collect` records."""
    model, system = truth.model, truth.system
    data, actions = mujoco.MjData(model), rng.uniform(-3, 3, (count, model.nu))
    actions[rng.random(count) < 0.2] = 0
    qpos = np.empty((count, length, model.nq))
    for row, action in zip(qpos, actions, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel = system.sample_start("random", rng)
        data.ctrl = action
        for frame in row:
            frame[:] = data.qpos
            mujoco.mj_step(model, data, round(system.timestep / model.opt.timestep))
    return Motion(qpos, np.repeat(actions[:, None], length - 1, axis=1))


def rod_angles(truth: Truth, x: Array) -> Array:
    """`[..., R]` of point masses `[..., K, 2]`, rad, clockwise from straight up."""
    rods = truth.system.mechanism.rods
    along = [x[..., r.end, :] - (0 if r.start is None else x[..., r.start, :]) for r in rods]
    return np.stack([np.arctan2(a[..., 0], a[..., 1]) for a in along], -1)


def near_truth(truth: Truth, rng: np.random.Generator, off: float = 0.03) -> tuple[Parts, Variables]:
    """A model whose numbers are some of the true ones' own size off: where training leaves it.

    Motors act where they do; that training finds it out is measured elsewhere.

    Args:
        truth: what to start beside.
        rng: draws how far.
        off: relative.
    """
    mechanism = truth.system.mechanism
    parts = Parts(ModelConfig(mechanism, truth.system.timestep))
    dynamics = jax.tree.map(lambda a: np.zeros(a.shape, a.dtype), parts.shapes()["dynamics"])

    def about(value: Array) -> Array:
        return value * np.exp(off * rng.normal(size=np.shape(value)))

    scale = parts.config.networks.force_scale
    dynamics["log_masses"] = np.log(about(truth.masses))
    lengths = np.concatenate([about(truth.lengths) ** 2 / 2, np.zeros(len(mechanism.sliders))])
    dynamics["level"] = lengths
    dynamics["pivot"] = np.asarray(mechanism.pivot)
    dynamics["potential"]["linear"]["kernel"][1::2, 0] = about(truth.weights) / scale
    linear = sparse_forces(truth) / scale
    dynamics["input"]["linear"] = {"kernel": about(linear[:-1]), "bias": about(linear[-1])}
    return parts, {"dynamics": jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), dynamics)}


def sparse_forces(truth: Truth) -> Array:
    """Forces `[n+1, n*m]`, linear in positions and 1, of each motor on the fewest point masses that it can act on."""
    qpos = np.random.default_rng(0).uniform(-2, 2, (40, truth.model.nq))
    x = truth.positions(qpos).reshape(len(qpos), -1)
    jacobian, rows = truth.jacobian(qpos), np.column_stack([x, np.ones(len(qpos))])
    count, n = truth.system.mechanism.num_keypoints, x.shape[1]
    out = np.zeros((n + 1, n, truth.model.nu))
    for motor, torque in enumerate(truth.torques.T):
        for size, points in ((s, p) for s in range(1, count + 1) for p in combinations(range(count), s)):
            where = np.repeat(2 * np.array(points), 2) + np.tile([0, 1], size)
            design = np.einsum("qb,qni->qibn", rows, jacobian[:, where]).reshape(-1, (n + 1) * len(where))
            asked = np.tile(torque, len(qpos))
            found = np.linalg.lstsq(design, asked, rcond=1e-9)[0]
            if np.allclose(design @ found, asked, atol=1e-5 * np.abs(asked).max()):
                out[:, where, motor] = found.reshape(n + 1, -1)
                break
    return out.reshape(n + 1, -1)
