"""Options that several commands have."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Option

from quadftc_campaign.errors import CampaignError


def page_at(out: Path) -> Path:
    """Return the HTML file that ``--out`` means: itself by its suffix, else report.html in that directory."""
    return out if out.suffix == ".html" else out / "report.html"


def ask_for_files(*paths: Path | None) -> None:
    """Raise OSError for a path that is not there, before what reads it is imported, which takes a second."""
    for path in paths:
        if path is not None:
            path.stat()


def complete_scenario(incomplete: str) -> list[str]:
    """Complete the name of a scenario in the shell; a path is completed by the shell itself."""
    from quadftc_flight.scenario.files import scenario_names

    return [name for name in scenario_names() if name.startswith(incomplete)]


def _part(module: str, registry: str, what: str) -> Any:
    """Return the option for another part of a scheme; the shell completes it from a registry."""

    def complete(incomplete: str) -> list[str]:
        names: tuple[str, ...] = getattr(importlib.import_module(module), registry).names()
        return [name for name in names if name.startswith(incomplete)]

    return Option(help=f"{what} in place of the scheme's.", autocompletion=complete)


ObserverOption = Annotated[str, _part("quadftc_fdi.fault_observer", "fault_observers", "Fault observer")]
DisturbanceObserverOption = Annotated[
    str, _part("quadftc_fdi.disturbance_observer", "disturbance_observers", "Disturbance observer")
]
ControllerOption = Annotated[str, _part("quadftc_control.controller", "controllers", "Controller")]
SetOption = Annotated[
    list[str],
    Option("--set", help="Any value of the scenario: a.b=v, faults.0.value='2 deg'; may be repeated."),
]
GainsOption = Annotated[
    str, Option(help="Tuned gains for the vehicle and its sensors: a name or a file (see gains/).")
]
JunitOption = Annotated[Path | None, Option(metavar="FILE", help="Write the checks as JUnit XML, too.")]
WorkersOption = Annotated[int | None, Option(help="Processes on this machine; default: one for each core.")]


def workers_here(workers: int | None) -> int:
    """Return how many processes to start on this machine; CampaignError if the number makes no sense."""
    if workers is not None and workers < 1:
        raise CampaignError(f"--workers {workers}: must be positive")
    return workers or len(os.sched_getaffinity(0))


EngineOption = Annotated[
    Literal["c", "numpy"], Option(help="What runs the laws: C that is generated from them, or NumPy.")
]
LOG_HELP = (
    "Flight log: ROS 1 or ROS 2 bag, PX4 ULog, ArduPilot .BIN or .log, MAVLink .tlog, Betaflight or INAV"
    " blackbox, Crazyflie uSD, CSV with --mapping; or any of them in a ZIP, gzip or Zstandard file."
)
NumberOption = Annotated[
    int,
    Option(
        "--log", min=0, metavar="N", show_default=False, help="Which of several logs in the file, from 1."
    ),
]
SystemOption = Annotated[
    int,
    Option(
        min=0,
        max=255,
        metavar="N",
        show_default=False,
        help="Which of several vehicles, by its MAVLink system.",
    ),
]
MappingOption = Annotated[
    Path | None, Option(metavar="FILE", help="What the columns of a CSV table mean (docs/diagnose.md).")
]
