"""The side of a batch benchmark that computes: one process, one core, told when to fly.

It runs in any Python from 3.10 on, that of another simulator too, and so imports nothing but the standard
library. It answers in lines of JSON on standard output: what is simulated when it has compiled, after each
"go" on standard input how long it took, and at the end of input how much memory it had.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

Job = dict[str, Any]


class Run(NamedTuple):
    """One run of a subject."""

    steps: int  # of all flights together
    drawing: float = 0.0  # of its time, that in which random numbers were drawn [s]


@dataclasses.dataclass(frozen=True)
class Subject:
    """What is measured.

    Parameters
    ----------
    what : dict
        What is simulated, and by which versions of what.
    run : callable
        Flies once, to the end, and says how far; compiles when it is called first.
    """

    what: dict[str, Any]
    run: Callable[[], Run]


def serve(prepare: Callable[[Job], Subject]) -> None:
    """Do the job that the command line describes: ``core`` to run on, ``least`` time of a measurement [s].

    A package that is not there, and any other error, is answered, not raised.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits for this one
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8", buffering=1)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is no answer
    job: Job = json.loads(sys.argv[1])
    os.sched_setaffinity(0, {job["core"]})
    try:
        for answer in _answers(prepare(job), job["least"]):
            answers.write(json.dumps(answer) + "\n")
    except ModuleNotFoundError as error:
        answers.write(json.dumps({"absent": f"{error.name} is not installed"}) + "\n")
    except Exception as error:
        answers.write(json.dumps({"failed": f"{type(error).__name__}: {error}".splitlines()[0]}) + "\n")


def _answers(subject: Subject, least: float) -> Any:
    first = _timed(subject, 1)["seconds"]
    again = _timed(subject, 1)["seconds"]
    yield {"what": subject.what, "compile_s": max(0.0, first - again)}
    times = max(1, math.ceil(least / again))
    for _ in sys.stdin:
        yield _timed(subject, times)
    yield {"memory_mib": peak_memory()}


def _timed(subject: Subject, times: int) -> dict[str, float]:
    begin = time.perf_counter()
    runs = [subject.run() for _ in range(times)]
    seconds = time.perf_counter() - begin
    return {
        "seconds": seconds,
        "runs": times,
        "steps": sum(each.steps for each in runs),
        "drawing": sum(each.drawing for each in runs),
    }


def peak_memory() -> float:
    """Most memory that this process has had [MiB]; ``getrusage`` would count that of its parent."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM:"))
    return round(int(line.split()[1]) / 1024, 1)
