"""A sweep over a Ray cluster that loses a machine ends with the weights of trainings that nothing disturbed."""

import sys
import threading
import time
from functools import partial

import numpy as np
import pytest
from sharded import train_one

from keycld_envs.workers import map_in_processes, map_on_ray
from keycld_model.checkpoint import flatten, read_checkpoint

SEEDS = range(3)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="Ray's clusters of several nodes are for Unix")
def test_a_training_whose_machine_is_lost_goes_on_elsewhere(cluster, tmp_path):
    nodes, machines = cluster
    together, alone = tmp_path / "together", tmp_path / "alone"
    together.mkdir()
    alone.mkdir()

    def lose() -> None:
        states = [together / str(seed) / "state" / "checkpoint.json" for seed in SEEDS[:2]]
        while not all(state.is_file() for state in states):  # until both machines are in the middle of a training
            time.sleep(0.02)
        nodes.remove_node(machines[0], allow_graceful=False)

    losing = threading.Thread(target=lose, daemon=True)
    losing.start()
    list(map_on_ray(partial(train_one, together), SEEDS, nodes.address))
    losing.join(10)
    assert not losing.is_alive()
    notes = {seed: (together / f"{seed}.txt").read_text().split("\n")[:-1] for seed in SEEDS}
    lost = [seed for seed in SEEDS if notes[seed] == ["begins", "goes on"]]
    assert len(lost) == 1 and all(notes[seed] == ["begins"] for seed in SEEDS if seed not in lost), notes
    list(map_in_processes(partial(train_one, alone), lost, 1))
    first, second = (flatten(read_checkpoint(folder / str(lost[0]))[0]) for folder in (together, alone))
    assert first.keys() == second.keys()
    for key, value in first.items():
        np.testing.assert_array_equal(value, second[key], err_msg=key)
