# pyright: basic
"""``quadftc replay``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from quadftc_cli.commands import options
from quadftc_cli.screen import Bars, console, say, warn

FAULT_HELP = "Overlay a fault: 'bias axis=roll value=3deg start=60s stop=80s'; may be repeated."
CHECK_HELP = "Hold a metric to a bound: 'diagnosis.total_false_alarms below=1'; may be repeated."
COLUMNS = tuple(
    f"fault_estimate_{kind}{end}_deg" for end in ("", "_inside", "_outside") for kind in ("rmse", "max")
)


Bag = Annotated[Path, Argument(metavar="BAG", help=options.LOG_HELP)]
Topic = Annotated[
    str, Option(help="Topic of the IMU, or name of a gyro; default: the only one, or imu/data.")
]
ObserverName = Annotated[str, Option(help="Fault observer; default: the recorded one with its parameters.")]
Settings = Annotated[list[str], Option("--set", help="Parameter of the observer: observer.L1=0.1.")]
VehicleName = Annotated[
    str, Option(help="Vehicle, by name or TOML file; default: the recorded one, or qball_x4.")
]
Fault = Annotated[list[str], Option(metavar="SPEC", help=FAULT_HELP)]
FaultFiles = Annotated[
    list[Path],
    Option(metavar="FILE.yaml", help="Overlay the faults of a file: the key faults of a scenario."),
]
Seed = Annotated[int, Option(help="Seed of random faults.")]
SkipBackwards = Annotated[bool, Option("--skip-backwards", help="Leave out samples whose stamp goes back.")]
Out = Annotated[Path, Option(help="Directory of the replays.", metavar="DIR")]
Force = Annotated[bool, Option("--force", help="Replace an earlier replay of the same name.")]
Check = Annotated[list[str], Option(metavar="SPEC", help=CHECK_HELP)]


def replay(
    bag: Bag,
    number: options.NumberOption = 0,
    system: options.SystemOption = 0,
    mapping: options.MappingOption = None,
    topic: Topic = "",
    observer: ObserverName = "",
    set_: Settings = [],  # noqa: B006
    vehicle: VehicleName = "",
    fault: Fault = [],  # noqa: B006
    faults: FaultFiles = [],  # noqa: B006
    seed: Seed = 0,
    skip_backwards: SkipBackwards = False,
    out: Out = Path("results"),
    force: Force = False,
    check: Check = [],  # noqa: B006
    junit: options.JunitOption = None,
    engine: options.EngineOption = "c",
) -> int:
    """Run a recorded IMU through the diagnosis, offline, with faults overlaid if asked; write a bag.

    Beside the bag, summary.json says how good the estimates are. The exit code is 1 if a check fails.
    """
    # a file that is missing is named before what takes seconds is imported
    options.ask_for_files(bag, *faults)
    from quadftc_cli.judging import judge
    from quadftc_cli.metric_table import axis_table, diagnosis_table
    from quadftc_flight.checks import parse_check
    from quadftc_replay.plan import ReplayOptions
    from quadftc_replay.readers import LogChoice
    from quadftc_replay.replay_bag import replay as replay_recording

    how = ReplayOptions(
        topic=topic,
        choice=LogChoice(number, system, mapping),
        observer=observer,
        settings=tuple(set_),
        vehicle=vehicle,
        faults=tuple(fault),
        fault_files=tuple(faults),
        seed=seed,
        skip_backwards=skip_backwards,
        checks=tuple(map(parse_check, check)),
        engine=engine,
    )
    with Bars(console()) as bars:
        summary = replay_recording(bag, how, out, force, bars.add(bag.resolve().name))
    warn(summary["warnings"])
    say(
        f"{summary['name']}: {summary['samples']} samples of {summary['topic']},"
        f" {summary['duration']:.1f} s at {summary['rate']:.1f} Hz,"
        f" {summary['real_time_factor']:.1f} x real time; truth: {summary['truth']}"
    )
    screen = console()
    screen.print(axis_table(summary["metrics"], COLUMNS))
    screen.print(diagnosis_table({summary["name"]: summary["metrics"]}, screen))
    say(f"bag and summary: {out / summary['bag']}")
    return judge({summary["name"]: summary["checks"]}, screen, junit, "replay")
