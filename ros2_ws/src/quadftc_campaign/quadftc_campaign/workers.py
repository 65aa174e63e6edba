# pyright: basic
"""Chunks as tasks of processes on this machine; a process that is lost is replaced, its task done again."""

from __future__ import annotations

import concurrent.futures as futures
import contextlib
import functools
import importlib.metadata
import importlib.util
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection, resource_tracker
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from quadftc_campaign.batch.engine import JAX, Progress
from quadftc_campaign.errors import CampaignError

T = TypeVar("T")

RETRIES = 3  # processes lost one after the other, without a task done between them
THREADS = "NPROC"  # so many threads has JAX
TAKE_ALL = "XLA_PYTHON_CLIENT_PREALLOCATE"  # whether JAX takes most of a GPU's memory at once
LOOK = 0.1  # s; between two looks at how far the workers are
PLUGINS = "jax_plugins"  # where JAX looks for accelerators
STOPPING = (signal.SIGINT, signal.SIGTERM)
_STOPPED = threading.Event()  # by one of them


class Workers:
    """Some processes of this machine."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool = self._new_pool()

    def submit(self, function: Callable[..., T], *arguments: object) -> futures.Future[T]:
        """Have a process call a function; it is started if need be, deaf to Ctrl-C."""
        with _deaf_children():
            return self._pool.submit(function, *arguments)

    def replace(self) -> None:
        """Start anew, when a process was lost."""
        self.end()
        self._pool = self._new_pool()

    def end(self) -> None:
        """End all processes, whatever they do."""
        processes: Any = getattr(self._pool, "_processes", None) or {}  # a public way is there from 3.14 on
        for process in list(processes.values()):
            process.terminate()
        self._pool.shutdown(cancel_futures=True)

    def _new_pool(self) -> futures.ProcessPoolExecutor:
        cores = max(1, len(os.sched_getaffinity(0)) // self.count)  # for each: JAX compiles in threads
        spawn = multiprocessing.get_context("spawn")
        return futures.ProcessPoolExecutor(self.count, spawn, functools.partial(_begin, cores))


@contextlib.contextmanager
def started_workers(count: int) -> Generator[Workers, None, None]:
    """Have so many processes at hand; Ctrl-C and SIGTERM end them, and are raised here as Ctrl-C."""
    with _stop_noted():
        workers = Workers(count)
        try:
            yield workers
            _heed()
        finally:
            workers.end()


def devices(workers: Workers, engine: str) -> str:
    """Say what the workers compute on with an engine, such as ``2 x cpu``."""
    device = workers.submit(_find_device, engine).result() if engine == JAX else "cpu"
    return f"{workers.count} x {device}"


def run_tasks(
    workers: Workers,
    function: Callable[..., T],
    arguments: Sequence[tuple[object, ...]],
    progress: Progress = lambda samples: None,
) -> Iterator[tuple[int, T]]:
    """Call a function in the workers; yield place and result of each call as it is done.

    Its last argument is like ``progress``, the others are given. What it raises is raised here; a
    `CampaignError` says that processes are lost again and again.
    """
    left, lost, told = dict(enumerate(arguments)), 0, 0.0
    with tempfile.TemporaryDirectory(prefix="quadftc-workers-") as folder:
        file = Path(folder, "samples")  # of each call, from the processes
        np.zeros(max(len(left), 1)).tofile(file)
        samples = np.memmap(file, np.float64, "r")
        while left:
            pending: dict[futures.Future[T], int] = {}
            try:
                for place, given in left.items():
                    pending[workers.submit(_call, function, given, file, place)] = place
                while pending:
                    _heed()
                    done, _ = futures.wait(pending, LOOK, futures.FIRST_COMPLETED)
                    if (now := float(samples.sum())) != told:
                        progress(round(now - told))
                        told = now
                    for future in done:
                        result = future.result()
                        place, lost = pending.pop(future), 0
                        del left[place]
                        yield place, result
            except BrokenProcessPool:
                if (lost := lost + 1) > RETRIES:
                    raise CampaignError(f"chunk {min(left)}: its process was killed {lost} times") from None
                workers.replace()
            finally:
                for future in pending:
                    future.cancel()


def has_accelerator() -> bool:
    """Whether JAX has another device than the CPU; without a plugin for one, JAX is not even loaded."""
    named = (
        bool(importlib.metadata.entry_points(group=PLUGINS)) or importlib.util.find_spec(PLUGINS) is not None
    )
    return named and _find_device(JAX) != "cpu"


def _begin(cores: int) -> None:
    """In a process, before anything else."""
    os.environ[THREADS] = str(cores)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    """End with the process that started this one, even if that is killed: nobody else would end it."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)


def _call(function: Callable[..., T], arguments: tuple[object, ...], file: Path, place: int) -> T:
    """In a process: call a function that says how many samples it has flown."""
    samples = np.memmap(file, np.float64, "r+")
    samples[place] = 0.0

    def progress(count: int) -> None:
        samples[place] += count

    return function(*arguments, progress)


def _find_device(engine: str) -> str:
    if engine != JAX:
        return "cpu"
    os.environ.setdefault(TAKE_ALL, "false")  # workers share a GPU
    import jax

    return jax.devices()[0].device_kind


@contextlib.contextmanager
def _stop_noted() -> Generator[None, None, None]:
    """Note Ctrl-C and SIGTERM for `_heed`: raised anywhere, they may leave processes behind."""
    _STOPPED.clear()
    is_main = threading.current_thread() is threading.main_thread()  # which alone has signals
    noted = [each for each in STOPPING if is_main and signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, lambda number, frame: _STOPPED.set()) for each in noted}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


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
