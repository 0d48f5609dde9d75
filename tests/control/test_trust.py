"""Images that show something else: the agent does not act on them, and goes on when images return."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracle import make_oracle, point_masses

from keycld_control import EnergyShapingAgent
from keycld_control.closed_loop import Loop, LoopSettings, make_loop
from keycld_control.observer import first_estimate, predicted
from keycld_control.plant import Plant
from keycld_control.plausibility import Plausibility, differences, evened
from keycld_control.trust import DOUBTFUL, first_trust, judged, trusted
from keycld_envs import REFERENCE_SYSTEMS
from keycld_envs.errors import InputError
from keycld_model import WorldModel
from keycld_model.stored import shipped_models

SEED = 20_000
KINDS = {
    "black": np.zeros_like,
    "white": lambda image: np.full_like(image, 255),
    "noise": lambda image: np.random.default_rng(0).integers(0, 256, image.shape).astype(np.uint8),
    "a white corner": lambda image: np.where(np.add.outer(np.arange(64), np.arange(64))[..., None] < 10, 255, image),
    "half of it": lambda image: np.where(np.arange(64)[None, :, None] < 32, image, 0),
    "upside down": lambda image: image[::-1].copy(),
    "mirrored": lambda image: image[:, ::-1].copy(),
}


@pytest.fixture(scope="module")
def loops() -> Iterator[Callable[[str], Loop]]:
    """Of a system by its name; once, for an agent takes seconds to compile. It has not seen anything yet."""
    with ExitStack() as stack:
        made = cache(lambda name: stack.enter_context(make_loop(LoopSettings(name, seed=SEED, start="random"))))

        def loop_of(name: str) -> Loop:
            if name not in shipped_models():
                pytest.skip(f"no weights for {name} in this installation")
            made(name).agent.reset()
            return made(name)

        yield loop_of


@pytest.mark.long
@pytest.mark.render
@pytest.mark.parametrize("name", REFERENCE_SYSTEMS)
def test_it_lets_go_of_what_it_cannot_see_and_goes_on_when_it_can(loops, name):
    loop = loops(name)
    agent, env = loop.agent, loop.env
    frame, info = env.reset(seed=SEED)
    last = round(0.3 / env.system.timestep) + 1
    for kind, change in KINDS.items():
        for _ in range(20):
            frame, _, _, _, info = env.step(agent.act(frame))
        assert agent.trusted, kind
        for k in range(last + 5):
            action = agent.act(change(frame).astype(np.uint8))
            assert not agent.trusted, kind
            assert k < last or not action.any(), kind
            frame, _, _, _, info = env.step(action)
    for _ in range(loop.steps):
        frame, _, _, _, info = env.step(agent.act(frame))
    assert agent.trusted and info["is_success"]


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize(
    "name", ["acrobot", *(pytest.param(n, marks=pytest.mark.long) for n in ("pendulum", "cartpole"))]
)
def test_a_camera_that_stands_still_is_noticed(loops, name):
    loop = loops(name)
    agent, env = loop.agent, loop.env
    frame, _ = env.reset(seed=SEED)
    for _ in range(5):
        frame, *_ = env.step(agent.act(frame))
    for _ in range(round(1.0 / env.system.timestep)):
        action = agent.act(frame)
        env.step(action)
    assert not agent.trusted and not action.any()


@pytest.mark.slow
@pytest.mark.render
def test_an_undisturbed_episode_is_trusted_throughout(loops):
    loop = loops("acrobot")
    frame, _ = loop.env.reset(seed=SEED)
    for _ in range(300):
        frame, *_ = loop.env.step(loop.agent.act(frame))
        assert loop.agent.trusted


def test_a_model_whose_answer_is_not_finite_is_refused():
    if "pendulum" not in shipped_models():
        pytest.skip("no weights in this installation")
    model = WorldModel.load("pendulum")
    image = model.render(np.array([[0.0, 0.45]]))
    dynamics = {**model.parameters["dynamics"], "log_masses": jnp.full(1, jnp.nan)}
    with pytest.raises(InputError):
        EnergyShapingAgent(model.with_parameters({**model.parameters, "dynamics": dynamics}), image).act(image)


@pytest.mark.slow
def test_surprises_raise_doubt_and_agreement_ends_it():
    plant = Plant.of(make_oracle("acrobot"))
    there = jnp.asarray(point_masses("acrobot", (0.3, 0.5)), jnp.float32)
    far = jnp.asarray(point_masses("acrobot", (1.2, -2.0)), jnp.float32)
    yes, no, still = jnp.array(True), jnp.array(False), jnp.zeros(2)
    estimate = first_estimate(plant, there)
    trust = first_trust(estimate, jnp.array(0))
    assert trusted(trust)
    estimate, trust = judged(
        plant, trust, predicted(plant, estimate, still), still, far, yes, no, no, plant.keypoint_noise
    )
    assert not trusted(trust) and trust.doubt > DOUBTFUL
    np.testing.assert_allclose(estimate.x, far, atol=1e-4)
    for _ in range(6):
        prior = predicted(plant, estimate, still)
        estimate, trust = judged(plant, trust, prior, still, prior.x, yes, no, no, plant.keypoint_noise)
    assert trusted(trust)
    prior = predicted(plant, estimate, still)
    unseen, trust = judged(plant, trust, prior, still, there, no, no, no, plant.keypoint_noise)
    np.testing.assert_array_equal(unseen.x, prior.x)
    assert not trusted(trust) and int(trust.unseen) == 1


def test_an_old_image_again_and_again_is_not_acted_on():
    """It agrees with itself, but the mechanism would not stay where it shows it."""
    plant = Plant.of(make_oracle("acrobot"))
    moving = first_estimate(plant, jnp.asarray(point_masses("acrobot", (0.3, 0.5)), jnp.float32))
    old = jnp.asarray(point_masses("acrobot", (1.2, -2.0)), jnp.float32)
    yes, no, still = jnp.array(True), jnp.array(False), jnp.zeros(2)
    step = jax.jit(
        lambda e, t, again: judged(
            plant, t, predicted(plant, e, still), still, old, yes, again, no, plant.keypoint_noise
        )
    )
    estimate, trust = step(moving, first_trust(moving, jnp.array(0)), no)
    for _ in range(round(0.5 / plant.timestep)):
        estimate, trust = step(estimate, trust, yes)
        assert not trusted(trust) and trust.beginning


@pytest.mark.slow
@pytest.mark.render
def test_a_mechanism_that_hangs_still_is_acted_on_again(loops):
    loop = loops("acrobot")
    agent, env = loop.agent, loop.env
    frame, _ = env.reset(options={"qpos": [np.pi, 0.0]})
    agent.act(np.zeros_like(frame))
    for _ in range(round(1.0 / env.system.timestep)):
        agent.act(frame)
        if agent.trusted:
            return
    pytest.fail("it waits for ever")


def test_what_is_no_image_stays_refused():
    if "pendulum" not in shipped_models():
        pytest.skip("no weights in this installation")
    model = WorldModel.load("pendulum")
    agent = EnergyShapingAgent(model, model.render(np.array([[0.0, 0.45]])))
    with pytest.raises(InputError, match="values outside 0 to 1, or NaN"):
        agent.act(np.full((64, 64, 3), np.nan))


def test_a_plain_background_does_not_tell_a_mirrored_image():
    noise = np.random.default_rng(0).normal(0, 0.004, (64, 64, 3))
    assert (evened(0.3 + noise) == 0.3 + noise).all()
    slope = np.broadcast_to(np.linspace(0, 1, 64)[None, :, None], (64, 64, 3))
    assert evened(slope)[:, :30] == pytest.approx(0.5)


def before_it(background: Any) -> Plausibility:
    """What a model knows that draws such a background, and nothing else."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 64), np.linspace(1, -1, 64)), axis=-1)[::2]
    even, arrays = evened(background)[::2], (np.zeros(0), background)
    drawn, background = map(jnp.asarray, arrays)
    return Plausibility(drawn, background, jnp.asarray(even), jnp.asarray(grid), jnp.ones(1), 0.0, np.inf)


def seems_mirrored(known: Plausibility, image: Any) -> bool:
    """Of a pendulum that stands up."""
    plant = Plant.of(make_oracle("pendulum"))
    return bool(differences(plant, known, jnp.asarray(image), jnp.array([0.0, 0.45]))[2])


def test_what_always_covers_the_pivot_does_not_tell_a_mirrored_image():
    background = np.full((64, 64, 3), 0.3)
    drawn = background.copy()
    drawn[30, 30] = 0.38  # the link itself, in most poses
    assert not seems_mirrored(before_it(drawn), background)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_background_tells_a_mirrored_image(noise):
    background = np.broadcast_to(np.linspace(0.2, 0.6, 64)[None, :, None], (64, 64, 3))
    image = background + np.random.default_rng(0).normal(0, noise, background.shape)
    assert not seems_mirrored(before_it(background), image)
    assert seems_mirrored(before_it(background), image[:, ::-1])
