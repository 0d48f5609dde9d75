"""Joint models are trained on all devices: the samples are divided, the step is the same."""

import json
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

STEPS = """
import json, sys
import jax, jax.numpy as jnp, numpy as np
from keycld_model.delan.levenberg_marquardt import LeastSquaresProblem, Point, step
x = np.linspace(-1, 1, 700)
def errors(w, x, y):
    return jnp.stack([jnp.tanh(w[0] * x[0] + w[1]) - y[0]])
problem = LeastSquaresProblem(errors, (x[:, None], np.tanh(1.5 * x - 0.3)[:, None]), np.array([0, -1]))
point = Point(np.array([0.5, 0.0]))
for _ in range(6):
    point = step(problem, point)
print(json.dumps({"devices": jax.device_count(), "w": point.w.tolist(), "cost": point.cost}))
"""


def steps(devices: int) -> dict[str, Any]:
    environment = os.environ | {"XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}"}
    done = subprocess.run([sys.executable, "-c", STEPS], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.long
def test_steps_on_four_devices_are_those_on_one() -> None:
    one, four = steps(1), steps(4)
    assert (one["devices"], four["devices"]) == (1, 4)
    np.testing.assert_allclose(four["w"], one["w"], rtol=1e-9)
    np.testing.assert_allclose(one["w"], [1.5, -0.3], atol=1e-3)
