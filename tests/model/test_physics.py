"""Constraints, accelerations and projections against autodiff, MuJoCo and conservation laws."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from keycld_envs import REFERENCE_SYSTEMS, get_system
from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_envs.projection import world_to_image
from keycld_model import physics
from keycld_model.physics.lagrangian import MULTIPLIER_REGULARISATION
from keycld_model.places import inner_rods

pytestmark = pytest.mark.usefixtures("unoptimised", "x64")

PENDULUM = get_system("pendulum").mechanism
CARTPOLE = get_system("cartpole").mechanism
ACROBOT = get_system("acrobot").mechanism
FREE = Mechanism(2, 1)
TRIANGLE = Mechanism(3, 1, rods=(Rod(None, 0), Rod(0, 1), Rod(1, 2), Rod(0, 2)))
CHAIN = Mechanism(4, 1, rods=(Rod(None, 0), Rod(0, 1), Rod(1, 2), Rod(2, 3)))
SLIDER_CRANK = Mechanism(2, 1, rods=(Rod(None, 0), Rod(0, 1)), sliders=(Slider(1),))
SCOTCH = Mechanism(2, 1, rods=(Rod(0, 1),), sliders=(Slider(0, (0.6, 0.8)), Slider(1, (1.0, 0.0))), pivot=(0.1, -0.2))
MECHANISMS = {
    **{name: get_system(name).mechanism for name in REFERENCE_SYSTEMS},
    "free": FREE,
    "chain of four": CHAIN,
    "triangle on a rod (closed loop)": TRIANGLE,
    "slider-crank (closed loop)": SLIDER_CRANK,
    "elliptic trammel (closed loop)": SCOTCH,
}
all_mechanisms = pytest.mark.parametrize("mechanism", MECHANISMS.values(), ids=MECHANISMS.keys())


def masses_of(mechanism):
    """Of keypoints, and of rods between two joints, if there are any."""
    return jnp.arange(1.0, mechanism.num_keypoints + len(inner_rods(mechanism)) + 1)


def state(mechanism, seed=0):
    """Positions in general, velocities on the tangent space."""
    rng = np.random.default_rng(seed)
    x, v = jnp.asarray(rng.normal(size=(2, 2 * mechanism.num_keypoints)))
    return x, physics.project_velocity(mechanism, masses_of(mechanism), x, v)


@all_mechanisms
def test_jacobian_and_curvature_are_the_derivatives(mechanism):
    x, v = jnp.asarray(np.random.default_rng(1).normal(size=(2, 2 * mechanism.num_keypoints)))
    pivot = jnp.array([0.3, -0.4])
    for p in (None, pivot):

        def phi(x, p=p):
            return physics.constraint(mechanism, x, p)

        assert phi(x).shape == (mechanism.num_constraints,)
        np.testing.assert_allclose(physics.constraint_jacobian(mechanism, x, p), jax.jacfwd(phi)(x), atol=1e-12)
        quadratic = jnp.einsum("cij,i,j->c", jax.hessian(phi)(x), v, v)
        np.testing.assert_allclose(physics.constraint_curvature(mechanism, v), quadratic, atol=1e-12)


def test_values_of_the_constraints():
    x = jnp.array([0.3, 0.4, 0.3, -0.6])
    np.testing.assert_allclose(physics.constraint(ACROBOT, x), [0.125, 0.5])
    np.testing.assert_allclose(physics.constraint(CARTPOLE, x), [0.5, 0.4])
    np.testing.assert_allclose(physics.constraint(ACROBOT, x, jnp.array([0.3, 0.0])), [0.08, 0.5])


@all_mechanisms
def test_accelerations_solve_the_equations_of_motion(mechanism):
    """M a + D Phi' lambda = f for some lambda, and D Phi a + <D^2 Phi, v> v = 0, by a dense solve."""
    x, v = state(mechanism)
    masses, force = masses_of(mechanism), jnp.asarray(np.random.default_rng(2).normal(size=x.shape))
    c, n = mechanism.num_constraints, x.size
    jacobian = np.asarray(physics.constraint_jacobian(mechanism, x))
    matrix = np.block([[np.asarray(physics.mass_matrix(mechanism, masses)), jacobian.T], [jacobian, np.zeros((c, c))]])
    right = np.concatenate([force, -np.asarray(physics.constraint_curvature(mechanism, v))])
    expected = np.linalg.solve(matrix, right)[:n]
    ours = physics.acceleration(mechanism, masses, force, x, v)
    schur = jacobian @ np.linalg.inv(physics.mass_matrix(mechanism, masses)) @ jacobian.T
    tolerance = 1e-9 + MULTIPLIER_REGULARISATION * (np.linalg.cond(schur) if c else 0)
    np.testing.assert_allclose(ours, expected, atol=10 * tolerance * np.abs(expected).max())


@all_mechanisms
def test_a_common_scale_of_masses_and_forces_changes_nothing(mechanism):
    x, v = state(mechanism)
    masses, force = masses_of(mechanism), jnp.sin(x)
    first = physics.acceleration(mechanism, masses, force, x, v)
    np.testing.assert_allclose(physics.acceleration(mechanism, 7 * masses, 7 * force, x, v), first, rtol=1e-9)
    level = physics.constraint(mechanism, x) + 0.01
    moved = physics.project_position(mechanism, masses, level, x)
    np.testing.assert_allclose(physics.project_position(mechanism, 7 * masses, level, x), moved, rtol=1e-9)


@all_mechanisms
def test_projections_reach_the_manifold_and_stay_there(mechanism):
    x, v = state(mechanism)
    masses = masses_of(mechanism)
    level = physics.constraint(mechanism, x)
    off = x + 0.05 * jnp.cos(jnp.arange(x.size))
    on = physics.project_position(mechanism, masses, level, off, iterations=8)
    np.testing.assert_allclose(physics.constraint(mechanism, on), level, atol=1e-9)
    np.testing.assert_allclose(physics.project_position(mechanism, masses, level, on), on, atol=1e-9)

    fast = v + jnp.sin(jnp.arange(x.size))
    tangent = physics.project_velocity(mechanism, masses, on, fast)
    scale = float(jnp.abs(physics.constraint_jacobian(mechanism, on) @ fast).max(initial=1.0))
    np.testing.assert_allclose(physics.constraint_jacobian(mechanism, on) @ tangent, 0, atol=1e-4 * scale)
    np.testing.assert_allclose(physics.project_velocity(mechanism, masses, on, tangent), tangent, atol=1e-4 * scale)
    # Orthogonal in the metric of the masses: no other tangent velocity has a smaller kinetic energy of the difference.
    basis = np.linalg.svd(np.asarray(physics.constraint_jacobian(mechanism, on)))[2][mechanism.num_constraints :]
    difference = np.asarray(physics.mass_matrix(mechanism, masses)) @ (fast - tangent)
    np.testing.assert_allclose(basis @ difference, 0, atol=1e-8 * scale)


def test_coinciding_keypoints_give_finite_values_and_gradients():
    x, v = jnp.zeros(4), jnp.ones(4)

    def total(x, v, masses):
        return jnp.sum(physics.acceleration(ACROBOT, masses, jnp.zeros(4), x, v)) + jnp.sum(
            physics.project_velocity(ACROBOT, masses, x, v)
        )

    point = (x.at[0].set(0.4).at[2].set(0.4), v, jnp.ones(2))  # the second rod has no length
    assert np.isfinite(total(*point))
    assert all(np.isfinite(g).all() for g in jax.grad(total, (0, 1, 2))(*point))


# MuJoCo ---------------------------------------------------------------------------------------------------------------


RATIOS = {"cartpole": 14.7, "acrobot": 0.957}
"""Of the first mass to the second."""


class Body:
    """A system in MuJoCo, with point masses at the landmarks' mass positions."""

    def __init__(self, name):
        self.system = get_system(name)
        self.model = self.system.compile()
        self.data = mujoco.MjData(self.model)
        self.bodies = [self.model.body(mark.body).id for mark in self.system.landmarks]
        self.local = np.array([mark.mass_position for mark in self.system.landmarks])

    def points(self, qpos):
        """[n] positions of the masses, image units."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        world = self.data.xpos[self.bodies] + np.einsum(
            "kij,kj->ki", self.data.xmat[self.bodies].reshape(-1, 3, 3), self.local
        )
        return world_to_image(self.model, self.data, world, self.system.camera, 64, 64).ravel()

    def jacobian(self, qpos):
        """[n, nv]."""
        h, eye = 1e-6, np.eye(len(qpos))
        return np.stack([(self.points(qpos + h * e) - self.points(qpos - h * e)) / (2 * h) for e in eye], axis=1)

    def inertia(self, qpos):
        """[nv, nv]."""
        self.data.qpos[:], self.data.qvel[:] = qpos, 0
        mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return full

    def masses(self):
        """[K] for which the points have the inertia of the bodies; fitted over many configurations, and its error."""
        rows, right = [], []
        for qpos in np.random.default_rng(0).uniform(-3, 3, (20, self.model.nq)):
            j = self.jacobian(qpos).reshape(-1, 2, self.model.nv)
            rows.append(np.einsum("kdi,kdj->ijk", j, j).reshape(-1, len(j)))
            right.append(self.inertia(qpos).ravel())
        a, b = np.concatenate(rows), np.concatenate(right)
        masses = np.linalg.lstsq(a, b, rcond=None)[0]
        return masses, np.abs(a @ masses - b).max() / np.abs(b).max()


@pytest.mark.parametrize(
    "name", [n for n in REFERENCE_SYSTEMS if all(mark.mass_position is not None for mark in get_system(n).landmarks)]
)
def test_point_masses_move_as_mujocos_bodies_do(name):
    body = Body(name)
    masses, error = body.masses()
    assert error < 1e-4
    if name in RATIOS:
        assert masses[0] / masses[1] == pytest.approx(RATIOS[name], rel=2e-3)
    rng = np.random.default_rng(3)
    for _ in range(10):
        qpos, qvel = rng.uniform(-3, 3, body.model.nq), rng.normal(0, 4, body.model.nv)
        jacobian = body.jacobian(qpos)
        body.data.qpos[:], body.data.qvel[:] = qpos, qvel
        body.data.ctrl[:] = rng.uniform(-3, 3, body.model.nu)
        mujoco.mj_forward(body.model, body.data)
        qacc, torque = body.data.qacc.copy(), body.data.qfrc_actuator.copy()
        body.data.qvel[:] = 0
        mujoco.mj_forward(body.model, body.data)
        gravity = body.data.qfrc_bias.copy()

        # Forces on the keypoints that do the same work; what they add along the rods, no motion can feel.
        force = np.linalg.pinv(jacobian.T) @ (torque - gravity)
        x, v = body.points(qpos), jacobian @ qvel
        ours = physics.acceleration(
            body.system.mechanism, jnp.asarray(masses), jnp.asarray(force), jnp.asarray(x), jnp.asarray(v)
        )
        h = 3e-4
        path = [body.points(qpos + t * qvel + t**2 / 2 * qacc) for t in (-2 * h, -h, 0, h, 2 * h)]
        true = np.array([-1, 16, -30, 16, -1]) @ np.array(path) / (12 * h**2)
        np.testing.assert_allclose(ours, true, atol=3e-4 * np.abs(true).max())
