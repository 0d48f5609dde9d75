import os

import pytest

os.environ.setdefault("MUJOCO_GL", "egl")  # dm_control, which the tests compare with, would pick GLFW first

from keycld_envs import SYSTEMS

PAPER_SYSTEMS = ("pendulum", "cartpole", "acrobot")


@pytest.fixture(params=sorted(SYSTEMS))
def name(request: pytest.FixtureRequest) -> str:
    """Every system, both variants."""
    return request.param


@pytest.fixture(params=PAPER_SYSTEMS)
def domain(request: pytest.FixtureRequest) -> str:
    """Every dm_control domain."""
    return request.param
