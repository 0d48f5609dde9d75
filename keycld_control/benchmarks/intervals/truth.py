"""What is true of a simulated mechanism in a world model's units, solved from MuJoCo's masses, energies and torques."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from keycld_envs import Landmark, Rod, System
from keycld_envs.projection import pose
from keycld_model.places import inner_rods

Array = NDArray[np.floating]
POSES = 40
"""Random poses from which point masses and weights are solved."""
STEP = 1e-6
"""rad or m; of central differences."""
SIZE = 64
"""Pixels of a frame's side."""


@dataclass(frozen=True)
class Truth:
    """In image units, seconds and the total of the point masses.

    Attributes:
        system: with its keypoints where the point masses are.
        model: the simulator.
        masses: `[K]` fractions of the total, then `[L]` in the middle of rods between two joints.
        weights: `[K]` downward forces on the point masses, image units per second squared.
        torques: `[nv, m]` joint torques per unit of action, image units squared per second squared (hinges).
    """

    system: System
    model: mujoco.MjModel
    masses: Array
    weights: Array
    torques: Array

    @property
    def lengths(self) -> Array:
        """`[R]` of the rods between point masses and from the pivot, image units."""
        x = self.positions(np.zeros(self.model.nq))
        starts = [np.asarray(self.system.mechanism.pivot) if r.start is None else x[r.start] for r in self._rods]
        return np.array([np.linalg.norm(x[r.end] - s) for r, s in zip(self._rods, starts, strict=True)])

    @property
    def _rods(self) -> tuple[Rod, ...]:
        return self.system.mechanism.rods

    def positions(self, qpos: Array) -> Array:
        """Point masses `[..., K, 2]`, image units, in poses `[..., nq]`."""
        data, flat = mujoco.MjData(self.model), qpos.reshape(-1, qpos.shape[-1])
        seen = []
        for each in flat:
            pose(self.model, data, each)
            seen.append(self.system.keypoints(self.model, data, SIZE, SIZE))
        return np.array(seen).reshape(*qpos.shape[:-1], -1, 2)

    def jacobian(self, qpos: Array) -> Array:
        """`[..., 2K, nv]` derivatives of the point masses' positions by joint positions `[..., nq]`."""
        steps = STEP * np.eye(self.model.nv)
        moved = [(self.positions(qpos + s) - self.positions(qpos - s)) / (2 * STEP) for s in steps]
        return np.stack([m.reshape(*qpos.shape[:-1], -1) for m in moved], axis=-1)

    def potential_energy(self, x: Array) -> Array:
        """V `[...]` of point masses `[..., K, 2]`, up to a constant."""
        return x[..., 1] @ self.weights

    def forces(self, qpos: Array) -> Array:
        """Forces `[..., 2K, m]` per unit of action, along the directions in which point masses can move."""
        jacobian = self.jacobian(qpos)
        return jacobian @ np.linalg.solve(np.swapaxes(jacobian, -1, -2) @ jacobian, self.torques)


def truth_of(system: System) -> Truth:
    """Point masses with exactly the energies of a mechanism whose links are hinges' and whose last link is a leaf.

    The last keypoint goes to where one point mass has its link's moment of inertia and its weight's moment.
    """
    model = system.compile()
    data, last = mujoco.MjData(model), model.nbody - 1
    mass, centre = model.body_mass[last], model.body_ipos[last, 2]
    place = float((model.body_inertia[last].max() + mass * centre**2) / (mass * centre))
    *others, end = system.landmarks
    system = replace(system, landmarks=(*others, Landmark(end.body, (0.0, 0.0, place))))
    first = Truth(system, model, *np.zeros((3, 1)))
    poses = np.random.default_rng(0).uniform(-1, 1, (POSES, model.nq))
    inertia, energy = np.empty((POSES, model.nv, model.nv)), np.empty(POSES)
    for i, data.qpos[:] in enumerate(poses):
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia[i])
        energy[i] = data.energy[0]
    j = first.jacobian(poses).reshape(POSES, -1, 2, model.nv)
    middles = [(j[:, start] + j[:, end]) / 2 for start, end in inner_rods(system.mechanism)]
    j = np.concatenate([j, *(middle[:, None] for middle in middles)], axis=1)
    each = np.einsum("pkdi,pkdj->pijk", j, j).reshape(-1, j.shape[1])
    masses = _solved(each, inertia.ravel())  # kg m^2 per squared image unit
    heights = np.column_stack([first.positions(poses)[..., 1], np.ones(POSES)])
    weights = _solved(heights, energy)[:-1]
    torques = np.zeros((model.nv, model.nu))
    torques[model.jnt_dofadr[model.actuator_trnid[:, 0]], range(model.nu)] = model.actuator_gear[:, 0]
    total = masses.sum()
    return Truth(system, model, masses / total, weights / total, torques / total)


def _solved(rows: Array, right: Array) -> Array:
    """The exact solution of linear equations; no point masses have these energies if there is none."""
    solution, *_ = np.linalg.lstsq(rows, right)
    assert np.allclose(rows @ solution, right, rtol=1e-6, atol=1e-6 * np.abs(right).max())
    return solution
