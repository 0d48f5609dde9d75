import os
import sys
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
sys.path.insert(0, str(Path(__file__).parent))  # tests share swinging.py

import jax
import pytest


@pytest.fixture
def x64() -> Iterator[None]:
    """Double precision, and no silent broadcasting between arrays of different rank."""
    with jax.enable_x64(True), jax.numpy_rank_promotion("raise"):
        yield


@pytest.fixture(scope="module")
def unoptimised() -> Iterator[None]:
    """Compile fast what runs once."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
