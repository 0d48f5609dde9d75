"""What must equal dm_control: steps and rewards to the bit, pixels in full quality, starts in distribution."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from keycld_envs import KeyCLDEnv, get_system
from keycld_envs.rewards import tolerance

Import = Callable[[str], Any]


def test_stock_steps_bit_identically(domain: str, dm_control: Import) -> None:
    theirs, rng = dm_control(f"suite.{domain}").swingup(random=0), np.random.default_rng(1)
    ours = KeyCLDEnv(f"{domain}-stock", obs_type="state")
    for _ in range(3):
        theirs.reset()
        qpos, qvel = theirs.physics.data.qpos.copy(), theirs.physics.data.qvel.copy()
        ours.reset(options={"qpos": qpos, "qvel": qvel})
        for _ in range(300):  # long enough for the stock cart to hit its end stop
            action = np.sign(rng.uniform(-0.2, 1, ours.model.nu)) * rng.uniform(0, 1, ours.model.nu)
            expected = theirs.step(action)
            state, reward, _, _, info = ours.step(action)
            np.testing.assert_array_equal(info["qpos"], theirs.physics.data.qpos)
            np.testing.assert_array_equal(info["qvel"], theirs.physics.data.qvel)
            np.testing.assert_array_equal(state, np.concatenate([info["qpos"], info["qvel"]]))
            assert reward == expected.reward
            assert info["energy"] == theirs.physics.data.energy.sum()
    if domain == "cartpole":
        assert abs(ours.data.qpos[0]) > 1.7


@pytest.mark.parametrize("variant", ["", "-stock"])
def test_rewards_are_dm_controls(domain: str, variant: str, dm_control: Import) -> None:
    """On random states of either variant, by dm_control's own task on the same model."""
    system, rng = get_system(domain + variant), np.random.default_rng(2)
    module = dm_control(f"suite.{domain}")
    task = module.swingup(random=0).task
    physics = module.Physics.from_xml_string(system.mjcf, dict(system.assets))
    ours = KeyCLDEnv(system, obs_type="state")
    rewards = []
    for spread in np.repeat([1.0, 0.3, 0.05], 30):
        ours.reset(
            options={
                "qpos": np.asarray(system.target_qpos) + spread * rng.uniform(-np.pi, np.pi, ours.model.nq),
                "qvel": spread * rng.normal(size=ours.model.nv),
            }
        )
        action = rng.uniform(ours.action_space.low, ours.action_space.high)
        _, reward, _, _, info = ours.step(action)
        with physics.reset_context():
            physics.data.qpos[:], physics.data.qvel[:] = info["qpos"], info["qvel"]
        physics.set_control(action)
        assert reward == pytest.approx(task.get_reward(physics), abs=1e-12)
        rewards.append(reward)
    assert min(rewards) < 0.05 and max(rewards) > 0.5  # both ends of the scale were seen


@pytest.mark.parametrize(("sigmoid", "value_at_margin"), [("gaussian", 0.1), ("gaussian", 0.7), ("quadratic", 0.0)])
@pytest.mark.parametrize(("bounds", "margin"), [((0.0, 0.0), 2.0), ((-0.5, 1.0), 0.0), ((-0.5, 1.0), 0.8)])
def test_tolerance_is_dm_controls(
    bounds: tuple[float, float], margin: float, sigmoid: Any, value_at_margin: float, dm_control: Import
) -> None:
    rewards = dm_control("utils.rewards")
    for x in (*np.linspace(-3, 3, 61), *bounds):
        ours = tolerance(x, bounds, margin, sigmoid, value_at_margin)
        assert ours == rewards.tolerance(x, bounds, margin, sigmoid, value_at_margin)


@pytest.mark.render
def test_full_quality_is_dm_controls_image(domain: str, dm_control: Import) -> None:
    theirs = dm_control(f"suite.{domain}").swingup(random=0)
    for camera in ("fixed", "lookatcart" if domain == "cartpole" else "lookat"):
        ours = KeyCLDEnv(f"{domain}-stock", render_quality="full", camera=camera, width=48, height=40)
        for _ in range(3):
            theirs.reset()
            image, _ = ours.reset(options={"qpos": theirs.physics.data.qpos})
            expected = theirs.physics.render(40, 48, camera_id=camera)
            assert np.abs(image.astype(int) - expected).max() <= 1
        ours.close()


def test_stock_cartpole_starts_like_dm_control() -> None:
    system, rng = get_system("cartpole-stock"), np.random.default_rng(0)
    assert system.start == "hanging"
    qpos, qvel = map(np.array, zip(*(system.sample_start("hanging", rng) for _ in range(4000)), strict=True))
    np.testing.assert_allclose(qpos.mean(0), [0, np.pi], atol=1e-3)
    for values in (qpos, qvel):
        np.testing.assert_allclose(values.std(0), 0.01, rtol=0.05)
