"""What only shows in another process: imports, machines without OpenGL, workers."""

import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import keycld_envs  # noqa: F401


def python(code: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
    """Run `code` in a fresh interpreter; None removes a variable."""
    env = {key: value for key, value in os.environ.items() if key not in environment and key != "PYOPENGL_PLATFORM"}
    env |= {key: value for key, value in environment.items() if value is not None}
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=120)


def test_import_loads_no_jax_and_opens_no_opengl() -> None:
    done = python(
        """
import sys, keycld_envs, gymnasium
env = gymnasium.make("KeyCLD/Acrobot-v0", obs_type="state")
env.reset(seed=0)
env.step(env.action_space.sample())
assert not {"jax", "flax", "keycld_model", "dm_control"} & set(sys.modules)
import mujoco.egl
assert mujoco.egl.EGL_DISPLAY is None
with open("/proc/self/maps") as maps:
    text = maps.read()
assert "libgallium" not in text and "_dri.so" not in text and "libnvidia-eglcore" not in text
""",
        MUJOCO_GL="egl",
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.render
def test_backend_is_chosen_when_nothing_is_set_even_after_mujoco() -> None:
    for first in ("", "import mujoco; "):
        done = python(
            first + "import keycld_envs, os; env = keycld_envs.KeyCLDEnv('acrobot'); env.reset(seed=0); "
            "print(os.environ['MUJOCO_GL'], env.render().std() > 10)",
            MUJOCO_GL=None,
            DISPLAY=None,
        )
        assert done.stdout.split() in (["egl", "True"], ["osmesa", "True"]), done.stderr


@pytest.mark.parametrize("requested", [None, "egl", "osmesa"])
def test_without_an_opengl_library_states_work_and_pixels_say_what_to_install(requested: str | None) -> None:
    done = python(
        """
import ctypes
load = ctypes.CDLL
def missing(name, *args, **kwargs):
    if name and ("EGL" in str(name) or "OSMesa" in str(name)):
        raise OSError(f"{name}: cannot open shared object file")
    return load(name, *args, **kwargs)
ctypes.CDLL = missing
import keycld_envs
env = keycld_envs.KeyCLDEnv("acrobot", obs_type="state")
env.reset(seed=0)
env.step([0.0, 0.0])
try:
    env.render()
except keycld_envs.InputError as error:
    print(error)
""",
        MUJOCO_GL=requested,
        DISPLAY=None,
    )
    assert done.returncode == 0, done.stderr
    assert "apt-get install" in done.stdout and done.stdout.count("\n") == 1
    assert ("libosmesa6" if requested == "osmesa" else "libegl1 libgl1-mesa-dri") in done.stdout


def test_rendering_that_is_switched_off_says_so() -> None:
    done = python(
        "import keycld_envs\ntry: keycld_envs.KeyCLDEnv('acrobot').reset()\n"
        "except keycld_envs.InputError as error: print(error)",
        MUJOCO_GL="disabled",
    )
    assert "switched off by MUJOCO_GL=disabled" in done.stdout, done.stderr


def test_a_backend_that_does_not_exist_is_named() -> None:
    done = python(
        "import keycld_envs\ntry: keycld_envs.KeyCLDEnv('acrobot').reset()\n"
        "except keycld_envs.InputError as error: print(error)",
        MUJOCO_GL="bogus",
    )
    assert "MUJOCO_GL is 'bogus'" in done.stdout and done.stdout.count("\n") == 1, done.stderr


@pytest.mark.render
def test_renderers_left_open_do_not_disturb_the_exit() -> None:
    done = python(
        "import keycld_envs\nenvs = [keycld_envs.KeyCLDEnv(name) for name in ('acrobot', 'pendulum')]\n"
        "for env in envs: env.reset(seed=0)",
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.render
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_is_told_instead_of_hanging() -> None:
    done = python(
        """
import os, keycld_envs
keycld_envs.KeyCLDEnv("acrobot").reset(seed=0)
if os.fork() == 0:
    try:
        keycld_envs.KeyCLDEnv("acrobot").reset(seed=0)
    except keycld_envs.InputError as error:
        print(error, flush=True)
    os._exit(0)
os.wait()
"""
    )
    assert "'spawn' or 'forkserver'" in done.stdout, done.stderr


@pytest.mark.render
def test_async_vector_env_renders_in_spawned_processes() -> None:
    single = gym.make("KeyCLD/Acrobot-v0")  # renders in this process, before the workers start
    expected = [single.reset(seed=seed)[0] for seed in (3, 4)]
    single.close()
    vector = gym.make_vec(
        "KeyCLD/Acrobot-v0", num_envs=2, vectorization_mode="async", vector_kwargs={"context": "spawn"}
    )
    try:
        images, infos = vector.reset(seed=3)
        assert images.shape == (2, 64, 64, 3) and infos["qpos"].shape == (2, 2)
        np.testing.assert_array_equal(images, expected)
        for _ in range(3):
            images, *_ = vector.step(vector.action_space.sample())
        assert np.abs(images.astype(int) - expected).max() > 50
    finally:
        vector.close()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_worker_that_is_ended_inside_a_collection_cleans_up_without_a_word(tmp_path: Path) -> None:
    (tmp_path / "work.py").write_text(
        """
import gc, time
from pathlib import Path

def callback(phase, info):
    Path("half").touch()
    time.sleep(0.1)

def busy(item):
    gc.callbacks.append(callback)
    try:
        gc.collect()
        time.sleep(9)
    finally:
        Path("half").unlink()
"""
    )
    (tmp_path / "run.py").write_text(
        """
import multiprocessing, threading, time
from pathlib import Path
from keycld_envs.workers import map_in_processes, end_processes
from work import busy

if __name__ == "__main__":
    thread = threading.Thread(target=lambda: list(map_in_processes(busy, [0], 1)))
    thread.start()
    while not Path("half").exists():
        time.sleep(0.01)
    end_processes(multiprocessing.active_children())
    print(Path("half").exists())
    thread.join()  # an interpreter that ends while the pool does says more than the worker
"""
    )
    done = subprocess.run([sys.executable, "run.py"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stdout == "False\n"
    assert "Exception ignored" not in done.stderr
