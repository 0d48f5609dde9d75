"""Work on a Ray cluster, one of whose machines is lost."""

import os
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from keycld_envs.errors import InputError
from keycld_envs.workers import map_on_ray

pytest.importorskip("ray")


def slow(folder: Path, item: int) -> tuple[int, int]:
    """Note who began, and take a while."""
    (folder / f"{item}-{os.getpid()}").touch()
    time.sleep(1.5)
    return item * item, os.getpid()


@pytest.mark.skipif(sys.platform == "win32", reason="Ray's clusters of several nodes are for Unix")
def test_what_a_lost_machine_was_doing_is_done_again(cluster, tmp_path):
    """Both machines work; one is lost in the middle of an item, and every item is done."""
    nodes, machines = cluster

    def lose() -> None:
        while len({p.name.split("-")[1] for p in tmp_path.iterdir()}) < 2:  # until both work
            time.sleep(0.02)
        nodes.remove_node(machines[0], allow_graceful=False)

    losing = threading.Thread(target=lose, daemon=True)
    losing.start()
    results = list(map_on_ray(partial(slow, tmp_path), range(6), nodes.address))
    losing.join(10)
    assert not losing.is_alive()
    assert [value for value, _ in results] == [0, 1, 4, 9, 16, 25]
    begun = sorted(p.name for p in tmp_path.iterdir())
    assert len(begun) > 6 and len({name.split("-")[0] for name in begun}) == 6  # one was begun twice


def test_a_cluster_that_is_not_there_is_told():
    with pytest.raises(InputError, match=r"no Ray cluster at '127\.0\.0\.1:1'.*ray start"):
        list(map_on_ray(abs, [1], "127.0.0.1:1"))


def test_without_ray_the_package_to_install_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install 'keycld\[ray\]'"):
        list(map_on_ray(abs, [1], "local"))
