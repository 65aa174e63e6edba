# pyright: basic
"""Runs side by side, a process for each: for lock-step flights, which take as much of a core as they get."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any, cast

from quadftc_flight.graph.plan import GraphError
from quadftc_flight.runs import RunOptions, run
from quadftc_flight.scenario import Scenario, Scheme
from quadftc_ros.executor import STOPPING

Job = tuple[Scenario, Scheme]
Follow = Callable[[int, float], bool]

STRIDE = 0.01  # share of a flight between two reports of a process


def run_side_by_side(
    jobs: Sequence[Job], out: Path, options: RunOptions, workers: int, follow: Follow
) -> list[dict[str, Any] | None]:
    """Fly jobs in processes of their own; return their summaries in order, None for one that was ended early.

    So many ``workers`` fly at a time, in lock-step. ``follow`` is called with a job's number and the share of
    its flight that is over; all end early when it returns False. What the first run that failed raised is
    raised when the others have been ended.
    """
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    waiting = list(enumerate(jobs))
    under_way: dict[Connection, tuple[int, BaseProcess]] = {}
    results: list[dict[str, Any] | None] = [None] * len(jobs)
    try:
        while waiting or under_way:
            while waiting and len(under_way) < workers:
                number, job = waiting.pop(0)
                here, there = context.Pipe(duplex=False)
                process = context.Process(target=_run_one, args=(*job, out, options, stop, there))
                _start(process)
                there.close()
                under_way[here] = number, process
            for connection in cast("list[Connection]", wait(list(under_way), timeout=0.5)):
                number, process = under_way[connection]
                message = _receive(connection, process)
                if isinstance(message, Exception):
                    raise message
                is_over = not isinstance(message, float)
                if is_over:
                    del under_way[connection]
                    process.join()
                    results[number] = message
                # a flight that was ended early has no summary, and got no further
                if message is not None and not follow(number, 1.0 if is_over else message):
                    stop.set()
                    waiting.clear()
    finally:
        stop.set()
        for _, process in under_way.values():
            process.join()
    return results


def _start(process: BaseProcess) -> None:
    """Start a process in which signals are blocked: whoever started it says when to end."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _receive(connection: Connection, process: BaseProcess) -> Any:
    """Take a share, a summary or an error; a process that died without a word is an error."""
    try:
        return connection.recv()
    except EOFError:
        process.join()
        return GraphError(f"a process of a flight died with code {process.exitcode}")


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
