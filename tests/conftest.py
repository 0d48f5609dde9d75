"""What tests of several packages share."""

import os
from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture
def cluster(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, list[Any]]]:
    """A Ray cluster of three: a head that does no work, and two machines of one processor each."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    modules = os.pathsep.join([str(request.path.parent), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", modules)  # what the machines call lies beside the test
    out = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    machines = [out.add_node(num_cpus=1) for _ in range(2)]
    out.wait_for_nodes()
    yield out, machines
    ray.shutdown()
    out.shutdown()
