"""Work spread over spawned processes; OpenGL does not survive a fork."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from keycld_envs.errors import InputError

T = TypeVar("T")
R = TypeVar("R")


def map_in_processes(function: Callable[[T], R], items: Iterable[T], workers: int) -> Iterator[R]:
    """Apply a picklable function to every item; results come in the order of the items.

    Args:
        function: called in a worker process.
        items: its arguments.
        workers: number of processes.

    Raises:
        InputError: if a worker process dies.
    """
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start_worker)
    try:
        yield from pool.map(function, items)
    except BrokenProcessPool as error:
        raise InputError("A worker process died, perhaps for want of memory; run again with fewer workers.") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Leave Ctrl-C to the parent, and end when the parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow_parent() -> None:
        parent = multiprocessing.parent_process()
        assert parent is not None
        parent.join()
        os._exit(1)

    threading.Thread(target=follow_parent, daemon=True).start()
