# pyright: basic
"""Chunks as tasks of Dask distributed: on the cores of this machine, or on a cluster that exists."""

from __future__ import annotations

import collections
import contextlib
import importlib.metadata
import importlib.util
import logging
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing import resource_tracker
from typing import Any

from quadftc_campaign.batch.engine import JAX, Progress
from quadftc_campaign.errors import CampaignError

RETRIES = 3  # of a chunk whose worker is lost
TOPIC = "quadftc-samples"  # on which workers say how far they are
THREADS = "NPROC"  # so many threads has JAX
TAKE_ALL = "XLA_PYTHON_CLIENT_PREALLOCATE"  # whether JAX takes most of a GPU's memory at once
NO_PROFILE = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}  # a sampler that takes 3 % of a core
TIMEOUT, LOOK = 30.0, 0.01  # s; to reach a scheduler, between two looks at what is done
_STOPPED = threading.Event()  # by Ctrl-C
PLUGINS = "jax_plugins"  # where JAX looks for accelerators


@contextlib.contextmanager
def cluster_client(address: str | None, workers: int) -> Generator[Any, None, None]:
    """Connect to the scheduler at an address (``tcp://10.0.0.1:8786``); None: start one here, with workers.

    A `CampaignError` says that there is no scheduler, or that it has no workers.
    """
    from dask.config import set as configured
    from distributed import Client, LocalCluster

    path = os.environ.get("PYTHONPATH")
    cores = max(1, len(os.sched_getaffinity(0)) // workers)  # for each worker: JAX compiles in threads
    with _ctrl_c_noted(), contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="quadftc-workers-"))
        stack.enter_context(configured({"temporary-directory": folder}))
        with _deaf_children():
            target = address or stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",  # any free port: it cannot be left out
                    silence_logs=logging.CRITICAL,  # what fails in a task is raised here
                    env={THREADS: str(cores)} | NO_PROFILE | ({} if path is None else {"PYTHONPATH": path}),
                )
            )
        try:
            client = stack.enter_context(Client(target, timeout=TIMEOUT, set_as_default=False))
            client.wait_for_workers(1, timeout=TIMEOUT)
        except (OSError, ValueError) as error:  # TimeoutError is an OSError
            raise CampaignError(f"scheduler {address or 'here'}: {_first_line(error)}") from None
        _heed()
        yield client
        _heed()


@contextlib.contextmanager
def _ctrl_c_noted() -> Generator[None, None, None]:
    """Note Ctrl-C for `_heed`: raised anywhere in Dask it may be lost, or leave processes behind."""
    _STOPPED.clear()
    is_main = threading.current_thread() is threading.main_thread()  # which alone has signals
    if not is_main or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        yield
        return
    before = signal.signal(signal.SIGINT, lambda number, frame: _STOPPED.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _heed() -> None:
    if _STOPPED.is_set():
        raise KeyboardInterrupt


@contextlib.contextmanager
def _deaf_children() -> Generator[None, None, None]:
    """Keep Ctrl-C from threads and processes that start meanwhile, for good: who started them ends them.

    A terminal sends it to all processes, and one that still starts would end with a traceback.
    """
    resource_tracker.ensure_running()  # else the thread that starts it listens again
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def has_accelerator() -> bool:
    """Whether JAX has another device than the CPU; without a plugin for one, JAX is not even loaded."""
    named = (
        bool(importlib.metadata.entry_points(group=PLUGINS)) or importlib.util.find_spec(PLUGINS) is not None
    )
    return named and _find_device(JAX) != "cpu"


def devices(client: Any, engine: str) -> str:
    """Say what the workers compute on with an engine, such as ``2 x cpu``."""
    found = collections.Counter(client.run(_find_device, engine).values())
    return ", ".join(f"{count} x {name}" for name, count in sorted(found.items()))


def run_tasks(
    client: Any,
    function: Callable[..., Any],
    arguments: Sequence[tuple[Any, ...]],
    progress: Progress = lambda samples: None,
) -> Iterator[tuple[int, Any]]:
    """Call a function in the workers; yield place and result of each call as it is done.

    Its last argument is like ``progress``, the others are given. What it raises is raised here; a
    `CampaignError` says that a call was lost with its worker again and again.
    """
    from distributed import KilledWorker, as_completed

    client.subscribe_topic(TOPIC, lambda event: progress(event[1]))
    futures = {
        client.submit(_call, function, each, retries=RETRIES, pure=False): place
        for place, each in enumerate(arguments)
    }
    try:
        done = as_completed(futures, loop=client.loop)
        while not done.is_empty():
            _heed()
            if not done.has_ready():
                time.sleep(LOOK)
                continue
            future = next(done)
            try:
                yield futures[future], future.result()
            except KilledWorker as error:
                raise CampaignError(f"chunk {futures[future]}: {_first_line(error)}") from None
            future.release()
    finally:
        client.cancel(list(futures))
        client.unsubscribe_topic(TOPIC)


def _call(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """In a worker."""
    from distributed import get_worker

    worker = get_worker()
    return function(*arguments, lambda samples: worker.log_event(TOPIC, samples))


def _find_device(engine: str) -> str:
    if engine != JAX:
        return "cpu"
    os.environ.setdefault(TAKE_ALL, "false")  # workers share a GPU
    import jax

    return jax.devices()[0].device_kind


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
