"""Options that several commands have."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from quadftc_campaign.errors import CampaignError

GainsOption = Annotated[
    str, typer.Option(help="Tuned gains for the vehicle and its sensors: a name or a file (see gains/).")
]
SchedulerOption = Annotated[
    str | None, typer.Option(help="Dask scheduler that exists, tcp://HOST:PORT; default: this machine.")
]
WorkersOption = Annotated[
    int | None, typer.Option(help="Processes on this machine; default: one for each core.")
]


def workers_here(workers: int | None, scheduler: str | None) -> int:
    """Return how many processes to start on this machine.

    Raises
    ------
    CampaignError
        If the number makes no sense, or is given together with a scheduler.
    """
    if workers is not None and (workers < 1 or scheduler is not None):
        raise CampaignError(
            f"--workers {workers}: must be positive, and is for this machine, not for --scheduler"
        )
    return workers or len(os.sched_getaffinity(0))
