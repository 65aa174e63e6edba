"""The process of a batch benchmark that computes, on one core.

It runs in any Python from 3.10 on, also in that of another simulator, and imports only the standard library.
It prints lines of JSON: once it has compiled, what it simulates; after each "go" on standard input, how long
it took; at the end of input, how much memory it had.
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
    """What is measured."""

    what: dict[str, Any]  # is simulated, and by which versions
    run: Callable[[], Run]  # flies once to the end; its first call compiles


def serve(prepare: Callable[[Job], Subject]) -> None:
    """Do the job on the command line, on its ``core``, each measurement for its ``least`` time [s].

    Errors, also a missing package, are answers; none is raised.
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
    first, second = (_time_runs(subject, 1)["seconds"] for _ in range(2))
    yield {"what": subject.what, "compile_s": max(0.0, first - second)}
    for _ in sys.stdin:
        yield _time_runs(subject, max(1, math.ceil(least / second)))
    yield {"memory_mib": peak_memory()}


def _time_runs(subject: Subject, times: int) -> dict[str, float]:
    begin = time.perf_counter()
    runs = [subject.run() for _ in range(times)]
    found = {"seconds": time.perf_counter() - begin, "runs": times}
    return {**found, **{key: sum(getattr(each, key) for each in runs) for key in ("steps", "drawing")}}


def peak_memory() -> float:
    """Most memory that this process has had [MiB]; ``getrusage`` would count that of its parent."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM:"))
    return round(int(line.split()[1]) / 1024, 1)
