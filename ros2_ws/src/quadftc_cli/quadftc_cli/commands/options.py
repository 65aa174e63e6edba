"""Options that several commands have."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from typer import Option

from quadftc_campaign.errors import CampaignError

ObserverOption = Annotated[str, Option(help="Fault observer in place of the scheme's.")]
DisturbanceObserverOption = Annotated[
    str, Option("--disturbance-observer", help="Disturbance observer in place of the scheme's.")
]
ControllerOption = Annotated[str, Option(help="Controller in place of the scheme's.")]
SetOption = Annotated[
    list[str],
    Option("--set", help="Any value of the scenario: a.b=v, faults.0.value='2 deg'; may be repeated."),
]
GainsOption = Annotated[
    str, Option(help="Tuned gains for the vehicle and its sensors: a name or a file (see gains/).")
]
JunitOption = Annotated[Path | None, Option(metavar="FILE", help="Write the checks as JUnit XML, too.")]
SchedulerOption = Annotated[
    str | None, Option(help="Dask scheduler that exists, tcp://HOST:PORT; default: this machine.")
]
WorkersOption = Annotated[int | None, Option(help="Processes on this machine; default: one for each core.")]


def workers_here(workers: int | None, scheduler: str | None) -> int:
    """Return how many processes to start on this machine; CampaignError if the number makes no sense."""
    if workers is not None and (workers < 1 or scheduler is not None):
        raise CampaignError(
            f"--workers {workers}: must be positive, and is for this machine, not for --scheduler"
        )
    return workers or len(os.sched_getaffinity(0))
