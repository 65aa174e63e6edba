"""How a graph in real time shares the machine: how it waits, real-time priority, and processor cores.

Linux gives a real-time priority to root, with the capability SYS_NICE, or within the limit ``rtprio`` of
/etc/security/limits.conf. Other systems have neither.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path

WAITS = ("sleep", "poll")
PRIORITIES = (1, 99)  # of SCHED_RR
_PR_SET_TIMERSLACK = 29


class SchedulingError(RuntimeError):
    """The machine does not allow it; the message says what would."""


@dataclasses.dataclass(frozen=True)
class Scheduling:
    """How a graph in real time shares the machine; ValueError for values that it cannot have."""

    wait: str = "sleep"  # between samples; ``poll`` keeps one core awake and therefore fast
    priority: int = 0  # of SCHED_RR, 1 to 99; 0: like all others
    cores: tuple[int, ...] = ()  # where to run; empty: anywhere

    def __post_init__(self) -> None:
        low, high = PRIORITIES
        if self.wait not in WAITS:
            raise ValueError(f"wait = {self.wait!r}: expected one of {', '.join(WAITS)}")
        if self.priority and not low <= self.priority <= high:
            raise ValueError(f"realtime priority = {self.priority}: expected {low} to {high}")
        if self.priority and self.wait == "poll":
            why = "Linux stops a real-time thread that never rests for 50 ms in every second"
            raise ValueError(f"realtime priority: not while polling, as {why}")
        if self.cores and (absent := sorted(set(self.cores) - set(range(os.cpu_count() or 1)))):
            raise ValueError(f"cores: there is no core {', '.join(map(str, absent))} on this machine")


ORDINARY = Scheduling()


@contextlib.contextmanager
def scheduled(scheduling: Scheduling) -> Generator[None, None, None]:
    """Run this thread, and processes that it starts, as asked; SchedulingError if the machine refuses."""
    with contextlib.ExitStack() as undo:
        if scheduling.wait == "poll":
            _call("prctl", _PR_SET_TIMERSLACK, 1, 0, 0, 0)  # ns; else each look takes 50 us more
            undo.callback(_call, "prctl", _PR_SET_TIMERSLACK, 0, 0, 0, 0)
        if scheduling.cores:
            before = os.sched_getaffinity(0)
            _allowed(lambda: os.sched_setaffinity(0, scheduling.cores), f"cores {scheduling.cores}", "")
            undo.callback(os.sched_setaffinity, 0, before)
        if scheduling.priority:
            number = scheduling.priority
            policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
            remedy = (
                f"; allow it by 'ulimit -r {number}', rtprio in /etc/security/limits.conf, or CAP_SYS_NICE"
            )
            ask = partial(os.sched_setscheduler, 0, os.SCHED_RR, os.sched_param(number))
            _allowed(ask, f"realtime priority {number}", remedy)
            undo.callback(os.sched_setscheduler, 0, policy, param)
        yield


def raise_priority(process: int, priority: int) -> None:
    """Give all threads of a running process, by its id, a priority of SCHED_RR; 0 changes nothing."""
    with contextlib.suppress(OSError):  # it may end at any time; whether it is allowed showed at its start
        for thread in Path(f"/proc/{process}/task").iterdir() if priority else ():
            os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(priority))


def _allowed(action: Callable[[], None], what: str, remedy: str) -> None:
    try:
        action()
    except (AttributeError, OSError) as error:
        words = getattr(error, "strerror", None) or "this system does not know of it"
        raise SchedulingError(f"{what}: {words}{remedy}") from None


def _call(name: str, *arguments: int) -> int:
    """Call a function of the C library; -1 where there is none of that name."""
    try:
        return int(getattr(ctypes.CDLL(None), name)(*arguments))
    except (AttributeError, OSError):
        return -1
