"""Bad input gets an InputError of one sentence that says what to do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import keycld_envs
from keycld_envs import REFERENCE_SYSTEMS, InputError, KeyCLDEnv, get_system, resolve_env_id
from keycld_envs.opengl import no_opengl


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"obs_type": "rgb"}, "obs_type must be one of 'pixels', 'state', 'pixels_state', got 'rgb'"),
        ({"width": 0}, "width must be a whole number of at least 2 pixels, got 0"),
        ({"height": -64}, "height must be a whole number"),
        ({"height": 64.5}, "height must be a whole number"),
        ({"render_width": 1}, "render_width must be a whole number"),
        ({"camera": "fixd"}, "has no camera 'fixd'; did you mean 'fixed'?"),
        ({"camera": "zzz"}, "it has 'fixed', 'lookat'"),
        ({"render_quality": "ultra"}, "render_quality must be one of 'fast', 'full'"),
        ({"start": "upright"}, "start must be one of 'random', 'hanging'"),
        ({"action_limit": 0}, "action_limit must be a positive finite number"),
        ({"action_limit": float("nan")}, "action_limit must be a positive finite number"),
        ({"action_limit": float("inf")}, "action_limit must be a positive finite number"),
        ({"render_mode": "ansi"}, "render_mode must be one of None, 'rgb_array'"),
        ({"system": "acrobat"}, "no system 'acrobat'; did you mean 'acrobot'"),
        ({"system": 5}, "system is 5; it must be a System"),
        ({"effects": 5}, "effects is 5; it must be a list of effects"),
        ({"disturbance": 3}, "disturbance is 3; it must be a Disturbance"),
    ],
)
def test_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        KeyCLDEnv(**{"system": "acrobot", **arguments})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"qpos": [0.0]}, r"qpos must have shape \(2,\), got \(1,\)"),
        ({"qpos": [[0.0, 0.0]]}, r"qpos must have shape \(2,\), got \(1, 2\)"),
        ({"qpos": [0.0, np.nan]}, "qpos must be finite"),
        ({"qpos": "upright"}, "qpos must be 2 numbers"),
        ({"qvel": [np.inf, 0.0]}, "qvel must be finite"),
        ({"pos": [0.0, 0.0]}, r"may have 'qpos' and 'qvel', not \['pos'\]"),
        ({"pos": 1, 2: 3}, r"may have 'qpos' and 'qvel', not \['pos', 2\]"),
    ],
)
def test_reset_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        KeyCLDEnv("acrobot", obs_type="state").reset(options=options)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([0.0, np.nan], "action must be finite"),
        ([0.0], r"action must have shape \(2,\), got \(1,\)"),
        (0.0, r"action must have shape \(2,\), got \(\)"),
        ("left", "action must be 2 numbers, got 'left'"),
        ([0.0, 10**400], r"action must be 2 numbers, got \[0\.0, 1000"),
    ],
)
def test_actions(action: Any, message: str) -> None:
    env = KeyCLDEnv("acrobot", obs_type="state")
    env.reset(seed=0)
    before = env.data.qpos.copy()
    with pytest.raises(InputError, match=message):
        env.step(action)
    np.testing.assert_array_equal(env.data.qpos, before)


def test_render_qpos() -> None:
    env = KeyCLDEnv("acrobot", obs_type="state")
    with pytest.raises(InputError, match=r"qpos must have shape \(2,\), got \(3,\)"):
        env.render_qpos([0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="width must be"):
        env.render_qpos([0.0, 0.0], width=0)


def test_a_display_that_is_not_there_is_named_with_what_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("DISPLAY", ":99")
    assert "DISPLAY=:99" in str(no_opengl("no X")) and "set MUJOCO_GL=egl" in str(no_opengl("no X"))
    monkeypatch.setenv("MUJOCO_GL", "egl")
    assert "libegl1" in str(no_opengl("no driver"))


@pytest.mark.parametrize("system", REFERENCE_SYSTEMS)
def test_a_simulation_that_diverges_in_its_first_step(system: str) -> None:
    env = KeyCLDEnv(system, obs_type="state")
    env.reset(options={"qvel": np.full(env.model.nv, 1e300)})
    for _ in range(2):  # and does not go on from where MuJoCo has put it
        with pytest.raises(InputError, match="The simulation diverged"):
            env.step(np.zeros(env.model.nu))
    env.reset(seed=0)
    env.step(np.zeros(env.model.nu))


def test_a_simulation_that_diverges_from_rest() -> None:
    env = KeyCLDEnv("cartpole", obs_type="state")
    env.reset(options={"qpos": [1e300, 0.0], "qvel": [0.0, 0.0]})
    with pytest.raises(InputError, match="The simulation diverged: system 'cartpole' ran away; use smaller actions"):
        env.step([0.0, 0.0])


def test_a_simulation_that_diverges_later() -> None:
    env = KeyCLDEnv("cartpole", obs_type="state")
    env.reset(options={"qpos": [0.0, 1.0], "qvel": [0.0, 1e4]})
    env.step([0.0, 0.0])
    with pytest.raises(InputError, match="The simulation diverged"):
        for _ in range(100):
            env.step([0.0, 0.0])
            env.data.qvel *= 10


@pytest.mark.parametrize(
    ("name", "suggestion"),
    [
        ("KeyCLD/Acrobat-v0", "KeyCLD/Acrobot-v0"),
        ("KeyCLD/Acrobot-v1", "KeyCLD/Acrobot-v0"),
        ("acrobott", "acrobot"),
        ("cartpole-stok", "cartpole-stock"),
        ("Walker", "pendulum"),
        ("json:acrobott", "json:acrobot"),
        ("my_modul:Slider", "no module 'my_modul'"),
        ("json.my_modul:Slider", "no module 'json.my_modul'"),
        (":acrobot", "'' in ':acrobot' is no module name"),
        ("my/module.py:Slider", "no module name"),
    ],
)
def test_unknown_ids_are_answered_with_suggestions(name: str, suggestion: str) -> None:
    for function in (resolve_env_id, keycld_envs.make):
        with pytest.raises(InputError) as caught:
            function(name)
        assert repr(name) in str(caught.value) and suggestion in str(caught.value)


def test_a_module_of_ones_own_that_fails_shows_its_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_broken_module.py").write_text("import my_missing_package")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="my_missing_package"):
        resolve_env_id("my_broken_module:MyLab/Slider-v0")


def test_unknown_systems_are_answered_with_suggestions() -> None:
    with pytest.raises(InputError, match="did you mean 'cartpole'"):
        get_system("cart-pole")
    with pytest.raises(InputError, match="'acrobot' or 'acrobot-stock' or 'cartpole'"):
        get_system("walker")
