"""Work spread over spawned processes (OpenGL does not survive a fork), or over the machines of a Ray cluster."""

import logging
import multiprocessing
import multiprocessing.process
import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

import mujoco

from keycld_envs.errors import InputError

T = TypeVar("T")
R = TypeVar("R")
RETRIES = 5
"""Times that work is done again whose machine was lost."""
KNOCK = 10.0
"""Seconds to wait for a cluster to answer."""
CLEANING = 0.8
"""Seconds that a process has to remove what it was writing before it is killed."""
SOON = 0.02
"""Seconds until a process tries again to leave, where it could not."""
ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
"""For `XLA_FLAGS` of processes among others, whose threads would wait for each other's."""


def each(function: Callable[[T], R], items: Sequence[T], workers: int, ray: str | None = None) -> Iterable[R]:
    """Results in order, from a Ray cluster, from processes with one thread of linear algebra each, or from this one."""
    if ray is not None:
        return map_on_ray(function, items, ray)
    if workers > 1:
        os.environ.setdefault("XLA_FLAGS", ONE_THREAD)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    return map(function, items) if workers == 1 else map_in_processes(function, items, workers)


def map_in_processes(function: Callable[[T], R], items: Iterable[T], workers: int) -> Iterator[R]:
    """Apply a picklable function to every item; results come in the order of the items.

    Args:
        function: called in a worker process.
        items: its arguments.
        workers: number of processes.

    Raises:
        InputError: if a worker process dies.
    """
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start_worker)
    try:
        with _without_interrupts():
            results = deque(pool.submit(function, item) for item in items)
        while results:  # not pool.map, which cancels on its way out what the pool then cannot give up
            yield results.popleft().result()
    except BrokenProcessPool as error:
        raise InputError("A worker process died, perhaps for want of memory; run again with fewer workers.") from error
    except BaseException:  # interrupted, or nobody asks for more: what they do now is not waited for
        end_processes([p for p in multiprocessing.active_children() if p not in others])
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def map_on_ray(function: Callable[[T], R], items: Iterable[T], address: str) -> Iterator[R]:
    """Apply a picklable function to every item on a Ray cluster; results come in the order of the items.

    What a machine was doing that is lost, the others do again. Files that `function` reads and writes must lie where
    all machines see them. Whether the cluster is there shows at once, work begins with the first result that is asked
    for.

    Args:
        function: called on any machine, with one processor.
        items: its arguments.
        address: "local" for a cluster on this machine alone, for as long as the work takes; "auto" for the one that
            this machine is part of; or host:port.

    Raises:
        InputError: if Ray is not installed, there is no such cluster, or something was lost more than `RETRIES` times.
    """
    try:
        import ray
    except ImportError as error:
        raise InputError(
            "Work is spread over machines by Ray; pip install 'keycld[ray]' or leave out --ray."
        ) from error
    own: dict[str, Any] = {"include_dashboard": False} if address == "local" else {}
    try:
        if ":" in address:  # Ray would knock for minutes
            host, port = address.rsplit(":", 1)
            socket.create_connection((host, int(port)), timeout=KNOCK).close()
        ray.init(address=address, logging_level=logging.WARNING, log_to_driver=False, **own)
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"There is no Ray cluster at {address!r}; `ray start --head` starts one.") from error
    return _from_ray(function, items)


def _from_ray(function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    import ray
    from ray.exceptions import NodeDiedError, WorkerCrashedError

    try:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_call)
        for reference in [task.remote(function, item) for item in items]:
            yield ray.get(reference)
    except (WorkerCrashedError, NodeDiedError) as error:
        raise InputError(
            f"Something was lost {RETRIES + 1} times with its machine; look at the cluster's logs."
        ) from error
    finally:
        ray.shutdown()


def _call(function: Callable[[T], R], item: T) -> R:
    return function(item)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let processes that start here never see Ctrl-C, not even while Python starts; this one sees it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_processes(processes: Sequence[multiprocessing.process.BaseProcess]) -> None:
    """End processes within a second, most of them after they have removed what they were writing."""
    for process in processes:
        process.terminate()
    deadline = time.monotonic() + CLEANING
    for process in processes:
        process.join(max(0.0, deadline - time.monotonic()))
        process.kill()


def _start_worker() -> None:
    """Leave Ctrl-C to the parent, clean up when it ends this process, and end when it is killed.

    MuJoCo's own warnings are left out, and its log file: a simulation that diverges is an error of ours. Cleaning up
    comes last: what is raised in here is printed by the pool, and there is nothing to clean up yet.
    """
    mujoco.set_mju_user_warning(lambda _: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow_parent() -> None:
        parent = multiprocessing.parent_process()
        assert parent is not None
        parent.join()
        os._exit(1)

    threading.Thread(target=follow_parent, daemon=True).start()
    signal.signal(signal.SIGTERM, _clean_up)


def _clean_up(number: int, frame: FrameType | None) -> None:
    """Leave what is being done, and this process."""
    threading.Timer(CLEANING / 2, os._exit, (143,)).start()
    sys.unraisablehook = _again
    _end(number, frame)


def _end(_: int, frame: FrameType | None) -> None:
    if _importing(frame):
        _again()
        return
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(143)


def _again(*_: object) -> None:
    """Try to leave once more: in a callback of the garbage collector, say, exceptions are lost."""
    signal.signal(signal.SIGTERM, _end)
    threading.Timer(SOON, os.kill, (os.getpid(), signal.SIGTERM)).start()


def _importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported; libraries in C++ abort if that ends half way."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
