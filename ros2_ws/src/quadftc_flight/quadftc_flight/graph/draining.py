"""What is still on its way to the recorder when a flight has ended."""

from __future__ import annotations

import time
from collections.abc import Callable

from quadftc_flight.graph.plan import AFTERMATH, STALL_TIMEOUT, GraphError

FEW = 10  # messages within AFTERMATH; real time: no more are those that still were on their way
QUIET = 0.25  # s; lock-step: when nothing more has come to be recorded for so long, all of it has


def drain(recorded: Callable[[], int], spin: Callable[[float], None], mode: str) -> None:
    """Spin on after the flight until what was published has been recorded.

    In real time messages never quite end: a controller without samples goes on to say so.

    Parameters
    ----------
    recorded : callable
        Messages received by the recorder so far.
    spin : callable
        ``spin(time)`` [s].
    mode : str
    """
    quiet, few = (QUIET, 0) if mode == "lockstep" else (AFTERMATH, FEW)
    end, total = time.monotonic() + STALL_TIMEOUT, recorded()
    spin(quiet)
    while recorded() - total > few:
        if time.monotonic() > end:
            raise GraphError("messages go on after the end of the flight")
        total = recorded()
        spin(quiet)
