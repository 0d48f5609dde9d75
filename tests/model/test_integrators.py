"""Integrators of constrained mechanics: their order and drift against MuJoCo's bodies, and what is symmetric."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from test_physics import Body

from keycld_model import physics
from keycld_model.physics import INTEGRATORS, PointMasses, in_parts, in_turns
from keycld_model.physics.integrators import projected, rattle

pytestmark = pytest.mark.usefixtures("unoptimised", "x64")
ORDERS = {"plain": 4, "velocity_projected": 4, "projected": 4, "rattle": 2}
SYSTEMS = {"pendulum": [2.0], "cartpole": [0.1, 2.0], "acrobot": [2.0, 0.7]}


class Swinging:
    """A passive system as point masses, and the same in MuJoCo."""

    def __init__(self, name):
        self.body, self.name = Body(name), name
        masses, _ = self.body.masses()
        x = jnp.asarray(self.body.points(np.array(SYSTEMS[name])))
        mechanism = self.body.system.mechanism
        pivot = jnp.asarray(mechanism.pivot)
        self.points = PointMasses(mechanism, jnp.asarray(masses), physics.constraint(mechanism, x, pivot), pivot)
        self.start = x, jnp.zeros_like(x)
        self.weight = jnp.asarray(self._weight(len(masses)))

    def _weight(self, count):
        """[n] constant forces on the points whose torques are those of gravity on the bodies."""
        rows, right = [], []
        for qpos in np.random.default_rng(0).uniform(-3, 3, (20, self.body.model.nq)):
            rows.append(self.body.jacobian(qpos)[1::2].T)
            self.body.inertia(qpos)  # at rest there
            right.append(-self.body.data.qfrc_bias)
        vertical = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
        return np.stack([np.zeros(count), vertical], axis=1).ravel()

    def force(self, x):
        return self.weight

    def run(self, integrator, steps, seconds=1.0):
        """Positions and velocities `[steps+1, n]`."""
        step = partial(integrator, self.points, self.force)
        _, path = jax.lax.scan(lambda s, _: (step(*s, seconds / steps),) * 2, self.start, length=steps)
        return tuple(jnp.concatenate([first[None], rest]) for first, rest in zip(self.start, path, strict=True))

    def mujoco_end(self, seconds=1.0, step=1e-4):
        """Positions `[n]` after some time, by MuJoCo's own Runge-Kutta method with small steps."""
        model, data = self.body.model, self.body.data
        model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
        mujoco.mj_resetData(model, data)
        data.qpos[:] = SYSTEMS[self.name]
        for _ in range(round(seconds / step)):
            mujoco.mj_step(model, data)
        return self.body.points(data.qpos.copy())

    def energy(self, x, v):
        kinetic = jax.vmap(partial(physics.kinetic_energy, self.points.mechanism, self.points.masses))(v)
        return np.asarray(kinetic - x @ self.weight)


@pytest.fixture(scope="module")
def swinging():
    with jax.enable_x64(True):
        return {name: Swinging(name) for name in SYSTEMS}


@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("system", SYSTEMS)
def test_order_against_mujoco(swinging, system, name):
    plant = swinging[system]
    truth = plant.mujoco_end()
    errors = [np.abs(plant.run(INTEGRATORS[name], n)[0][-1] - truth).max() for n in (12, 48)]
    order = np.log2(errors[0] / errors[1]) / 2
    assert ORDERS[name] - 0.6 < order < ORDERS[name] + 1.1


@pytest.mark.parametrize("system", SYSTEMS)
def test_what_stays_on_the_constraints(swinging, system):
    plant, off = swinging[system], {}
    for name, integrator in INTEGRATORS.items():
        x, v = plant.run(integrator, 200, 5.0)
        phi = jax.vmap(lambda x: physics.constraint(plant.points.mechanism, x, plant.points.pivot))(x)
        jacobian = jax.vmap(lambda x: physics.constraint_jacobian(plant.points.mechanism, x, plant.points.pivot))(x)
        rate = jnp.einsum("tcn,tn->tc", jacobian, v)
        off[name] = float(np.abs(phi - plant.points.level[None]).max()), float(np.abs(rate).max())
    assert off["rattle"][0] < 1e-12 and off["projected"][0] < 1e-10
    assert off["velocity_projected"][0] < off["plain"][0] / 50
    assert max(off[name][1] for name in ("velocity_projected", "projected", "rattle")) < 1e-6 < off["plain"][1]


@pytest.mark.parametrize("system", SYSTEMS)
def test_energy_drifts_where_the_step_is_not_symmetric(swinging, system):
    plant, drift = swinging[system], {}
    for name, integrator in {**INTEGRATORS, "in four": in_parts(projected, 4)}.items():
        x, v = plant.run(integrator, 1000, 25.0)
        energy = plant.energy(x, v)
        drift[name] = abs(energy[-333:].mean() - energy[:333].mean()) / np.ptp(np.asarray(x) @ plant.weight)
    assert drift["projected"] < 1e-3 < 5e-3 < drift["plain"]
    assert drift["rattle"] < 1e-3  # at order two, and steps as long
    assert drift["in four"] < drift["projected"] / 10


@pytest.mark.slow
def test_rattle_runs_backwards_to_where_it_began(swinging):
    plant = swinging["acrobot"]
    x, v = plant.run(rattle, 50)
    again, speed = x[-1], -v[-1]
    for _ in range(50):
        again, speed = rattle(plant.points, plant.force, again, speed, 1 / 50)
    np.testing.assert_allclose(again, x[0], atol=1e-6)
    np.testing.assert_allclose(speed, -v[0], atol=1e-5)


def test_fast_rods_are_moved_in_parts(swinging):
    """Twenty turns per second, a third of a turn per frame."""
    plant = swinging["pendulum"]
    x, _ = plant.start
    arm = np.asarray(x - plant.points.pivot)
    speed = 2 * np.pi * 20.0
    assert float(plant.points.turning(speed * jnp.array([-arm[1], arm[0]]))) == pytest.approx(speed)
    for integrator, far in ((projected, True), (in_turns(projected), False)):
        state = x, speed * jnp.array([-arm[1], arm[0]])
        step = jax.jit(partial(integrator, plant.points, jnp.zeros_like))
        for _ in range(60):
            state = step(*state, 1 / 60)
        assert (np.abs(state[0] - x).max() > 0.1 * np.linalg.norm(arm)) == far


def test_slow_rods_are_moved_at_once(swinging):
    plant = swinging["acrobot"]
    for ours, theirs in zip(plant.run(in_turns(projected, 10.0), 20), plant.run(projected, 20), strict=True):
        np.testing.assert_array_equal(ours, theirs)
