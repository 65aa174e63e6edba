# pyright: basic
"""Runs side by side, a process for each: for lock-step flights, which take as much of a core as they get."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path

from quadftc_flight.graph.plan import GraphError
from quadftc_flight.runs import RunOptions, run
from quadftc_flight.scenario import Scenario, Scheme
from quadftc_flight.summary import Summary
from quadftc_ros.executor import STOPPING

Job = tuple[Scenario, Scheme]

STRIDE = 0.01  # share of a flight between two reports of a process


def run_side_by_side(
    jobs: Sequence[Job], out: Path, options: RunOptions, workers: int, follow: Callable[[int, float], bool]
) -> list[Summary | None]:
    """Fly jobs in processes of their own; return their summaries in order, None for one that was ended early.

    So many ``workers`` fly at a time, in lock-step. ``follow`` is called with a job's number and the share of
    its flight that is over; all end early when it returns False. What the first run that failed raised is
    raised when the others have been ended.
    """
    context = multiprocessing.get_context("spawn")
    stop = context.Event()

    def fly(number: int, job: Job) -> Summary | None:
        if stop.is_set():
            return None
        here, there = context.Pipe(duplex=False)
        process = context.Process(target=_run_one, args=(*job, out, options, stop, there))
        process.start()
        there.close()
        while True:
            try:
                answer = here.recv()
            except EOFError:
                process.join()
                answer = GraphError(f"a process of a flight died with code {process.exitcode}")
            if isinstance(answer, Exception):
                stop.set()
                raise answer
            is_over = not isinstance(answer, float)
            # a flight that was ended early has no summary, and got no further
            if answer is not None and not follow(number, 1.0 if is_over else answer):
                stop.set()
            if is_over:
                process.join()
                return answer

    # signals are blocked in the threads, and so in their processes: whoever started them says when to end
    block = partial(signal.pthread_sigmask, signal.SIG_BLOCK, STOPPING)
    with ThreadPoolExecutor(workers, initializer=block) as threads:
        try:
            return list(threads.map(fly, range(len(jobs)), jobs))
        finally:
            stop.set()


def _run_one(
    scenario: Scenario, scheme: Scheme, out: Path, options: RunOptions, stop: Event, answers: Connection
) -> None:
    """Fly in this process. Its graph finds nobody outside it, so flights side by side do not mix."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    reported = 0.0

    def follow(share: float) -> bool:
        nonlocal reported
        if share - reported >= STRIDE:
            reported = share
            answers.send(share)
        return not stop.is_set()

    try:
        answers.send(run(scenario, scheme, out, options, follow))
    except Exception as error:
        answers.send(error)
