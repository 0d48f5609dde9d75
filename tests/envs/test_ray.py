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


LOST = "lost"


def held(folder: Path, item: int) -> int:
    """Note who began; work until a machine is lost, and well after, since a process outlives its machine a little."""
    (folder / f"{item}-{os.getpid()}").touch()
    if not (folder / LOST).exists():
        deadline = time.monotonic() + 120
        while not (folder / LOST).exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        time.sleep(5)
    return item * item


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="Ray's clusters of several nodes are for Unix")
def test_what_a_lost_machine_was_doing_is_done_again(cluster, tmp_path):
    """Both machines work; one is lost in the middle of an item, and every item is done."""
    nodes, machines = cluster

    def lose() -> None:
        while len({p.name.split("-")[1] for p in tmp_path.iterdir()}) < 2:  # until both work
            time.sleep(0.02)
        nodes.remove_node(machines[0], allow_graceful=False)
        (tmp_path / LOST).touch()

    losing = threading.Thread(target=lose, daemon=True)
    losing.start()
    assert list(map_on_ray(partial(held, tmp_path), range(6), nodes.address)) == [0, 1, 4, 9, 16, 25]
    losing.join(10)
    assert not losing.is_alive()
    begun = [p.name.split("-")[0] for p in tmp_path.iterdir() if p.name != LOST]
    assert len(begun) == 7 and len(set(begun)) == 6  # one was begun twice


def test_a_cluster_that_is_not_there_is_told():
    with pytest.raises(InputError, match=r"no Ray cluster at '127\.0\.0\.1:1'.*ray start"):
        map_on_ray(abs, [1], "127.0.0.1:1")


def test_without_ray_the_package_to_install_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install 'keycld\[ray\]'"):
        map_on_ray(abs, [1], "local")
