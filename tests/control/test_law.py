import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from oracle import SYSTEMS, make_oracle, point_masses, velocities
from scipy.optimize import lsq_linear

from keycld_control.law import nearest_action, paper_action, projected_action, turning_action
from keycld_control.plant import Plant, Response, acceleration, energy
from keycld_envs import get_system
from keycld_model.numerics import null_space
from keycld_model.physics import constraint_jacobian

KP, KD = 40.0, 10.0
FREE = np.inf


@pytest.fixture(autouse=True)
def _double_precision():
    with jax.enable_x64(True):
        yield


def random_state(name: str, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A configuration, joint speeds, and a target configuration."""
    rng = np.random.default_rng(seed)
    size = len(get_system(name).joints)
    return rng.uniform(-2, 2, size), rng.normal(0, 2, size), np.zeros(size)


def keypoint_state(name: str, seed: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    qpos, qvel, target = random_state(name, seed)
    return (
        jnp.asarray(point_masses(name, qpos)),
        jnp.asarray(velocities(name, qpos, qvel)),
        jnp.asarray(point_masses(name, target)),
    )


def act(law, plant: Plant, x, v, target, limit: float = FREE):
    bounds = jnp.full(plant.mechanism.num_actions, limit)
    return law(plant, x, v, target, KP, KD, -bounds, bounds)


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_oracle_accelerates_like_mujoco(name):
    qpos, qvel, _ = random_state(name, 0)
    model = get_system(name).compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, 1.5
    mujoco.mj_forward(model, data)
    h = 1e-4
    ahead = velocities(name, qpos + h * qvel, qvel + h * data.qacc)
    behind = velocities(name, qpos - h * qvel, qvel - h * data.qacc)
    x, v, _ = keypoint_state(name, 0)
    found = acceleration(Plant.of(make_oracle(name)), x, v, jnp.full(model.nu, 1.5))
    np.testing.assert_allclose(found, (ahead - behind) / (2 * h), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("seed", range(2))
def test_projected_law_is_the_formula_on_the_null_space(name, seed):
    plant = Plant.of(make_oracle(name))
    x, v, target = keypoint_state(name, seed)
    mass = jnp.diag(jnp.repeat(plant.masses, 2))
    force = jax.grad(plant.potential_energy)(x) - mass @ (KP * (x - target) + KD * v)
    basis = null_space(constraint_jacobian(plant.mechanism, x))
    for n in (basis, basis @ jnp.asarray(np.random.default_rng(seed).normal(size=(basis.shape[1],) * 2))):
        formula = jnp.linalg.solve(n.T @ plant.input_matrix(x), n.T @ force)
        np.testing.assert_allclose(act(projected_action, plant, x, v, target), formula, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", SYSTEMS)
def test_paper_law_is_its_formula(name):
    plant = Plant.of(make_oracle(name))
    x, v, target = keypoint_state(name, 1)
    g = plant.input_matrix(x)
    force = jax.grad(plant.potential_energy)(x) - KP * (x - target)
    np.testing.assert_allclose(
        act(paper_action, plant, x, v, target), jnp.linalg.pinv(g) @ force - KD * g.T @ v, rtol=1e-6
    )


@pytest.mark.parametrize("law", [projected_action, turning_action])
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("change", [{"scale": 7.0}, {"normal": 3.0}])
def test_what_data_cannot_determine_does_not_matter(name, law, change):
    x, v, target = keypoint_state(name, 2)
    expected = act(law, Plant.of(make_oracle(name)), x, v, target)
    np.testing.assert_allclose(act(law, Plant.of(make_oracle(name, **change)), x, v, target), expected, rtol=1e-3)


@pytest.mark.parametrize("name", SYSTEMS)
def test_it_does_matter_to_the_paper_law(name):
    x, v, target = keypoint_state(name, 2)
    plain = act(paper_action, Plant.of(make_oracle(name)), x, v, target)
    assert jnp.abs(act(paper_action, Plant.of(make_oracle(name, normal=3.0)), x, v, target) - plain).max() > 0.1


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("seed", range(2))
def test_projected_law_is_passive(name, seed):
    """d/dt (T + kp |x - x*|^2_M / 2) = -kd |v|^2_M."""
    plant = Plant.of(make_oracle(name))
    x, v, target = keypoint_state(name, seed)
    weight = jnp.repeat(plant.masses, 2)

    def shaped(x, v):
        return energy(plant, x, v) - plant.potential_energy(x) + KP * jnp.sum(weight * (x - target) ** 2) / 2

    a = acceleration(plant, x, v, act(projected_action, plant, x, v, target))
    _, rate = jax.jvp(shaped, (x, v), (v, a))
    np.testing.assert_allclose(rate, -KD * jnp.sum(weight * v**2), rtol=1e-3)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("seed", range(2))
def test_turning_law_makes_every_coordinate_a_damped_oscillator(name, seed):
    """In MuJoCo: the absolute angle of every link, and the cart's position, obey q'' = -kp q - kd q'."""
    qpos, qvel, target = random_state(name, seed)
    qpos, qvel = 0.05 * qpos, 0.1 * qvel  # within the speed limit of the reference
    model = get_system(name).compile()
    data = mujoco.MjData(model)
    x, v = jnp.asarray(point_masses(name, qpos)), jnp.asarray(velocities(name, qpos, qvel))
    model.actuator_ctrllimited[:] = False
    data.qpos[:], data.qvel[:] = qpos, qvel
    data.ctrl[:] = act(turning_action, Plant.of(make_oracle(name)), x, v, jnp.asarray(point_masses(name, target)))
    mujoco.mj_forward(model, data)
    absolute = np.array([[1, 0], [1, 1]]) if name == "acrobot" else np.eye(model.nv)
    np.testing.assert_allclose(absolute @ data.qacc, absolute @ (-KP * qpos - KD * qvel), rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("name", SYSTEMS)
def test_hanging_is_an_equilibrium_of_the_projected_law_only(name):
    plant = Plant.of(make_oracle(name))
    hanging = jnp.asarray(point_masses(name, get_system(name).hanging_qpos))
    target, rest = jnp.asarray(point_masses(name, (0.0, 0.0))), jnp.zeros_like(hanging)
    moves = {
        law: jnp.abs(acceleration(plant, hanging, rest, act(law, plant, hanging, rest, target))).max()
        for law in (projected_action, turning_action)
    }
    assert moves[projected_action] < 1e-4
    assert moves[turning_action] > 10


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize("seed", range(2))
def test_nearest_action_solves_the_bounded_least_squares_problem(size, seed):
    rng = np.random.default_rng(seed)
    inputs, wanted, free = rng.normal(size=(6, size)), 3 * rng.normal(size=6), rng.normal(size=6)
    weight, high = rng.uniform(0.5, 2, 6), rng.uniform(0.2, 1, size)
    expected = lsq_linear(np.sqrt(weight)[:, None] * inputs, np.sqrt(weight) * (wanted - free), (-high, high)).x
    response = Response(jnp.asarray(free), jnp.asarray(inputs), jnp.asarray(weight[:, None] * inputs))
    found = nearest_action(response, jnp.asarray(wanted), -jnp.asarray(high), jnp.asarray(high))
    np.testing.assert_allclose(found, expected, atol=2e-3)
