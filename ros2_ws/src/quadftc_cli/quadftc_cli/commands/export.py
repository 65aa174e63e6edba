"""``quadftc export``."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from quadftc_cli.screen import say


def complete_law(incomplete: str) -> list[str]:
    """Complete the name of a law in the shell."""
    from quadftc_cli.exporting import KINDS

    return [name for kind in KINDS for name in kind.registry.names() if name.startswith(incomplete)]


class Autopilot(str, Enum):
    """Whose log is written."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


Law = Annotated[
    str,
    Argument(
        metavar="[LAW|BAG]",
        help="A fault observer, a disturbance observer or a controller, see quadftc list; with --log any"
        " flight log.",
        autocompletion=complete_law,
    ),
]
VehicleName = Annotated[str, Option(help="Vehicle that it is for, by name or TOML file.")]
IsSingle = Annotated[bool, Option("--float", help="In single precision; default: double.")]
Flies = Annotated[
    bool, Option("--free-flight", help="With rotors and position; default: the test stand's inputs.")
]
Settings = Annotated[list[str], Option("--set", help="Parameter of the law: name=value; may be repeated.")]
Samples = Annotated[
    Path | None,
    Option(metavar="BAG", help="Write a recording as a file of samples (CSV) for the law instead."),
]
Topic = Annotated[str, Option(help="Topic of the IMU of the recording, see quadftc replay.")]
LogOf = Annotated[
    Autopilot | None,
    Option(help="Write BAG as this autopilot logs a flight by default instead: .BIN or ULog."),
]
Out = Annotated[Path | None, Option(help="Directory of the C; file of the samples or of the log.")]
Force = Annotated[bool, Option("--force", help="Write over what is there.")]


def export(
    law: Law = "",
    vehicle: VehicleName = "",
    single: IsSingle = False,
    flies: Flies = False,
    set_: Settings = [],  # noqa: B006
    samples: Samples = None,
    topic: Topic = "",
    log: LogOf = None,
    out: Out = None,
    force: Force = False,
) -> int:
    """Write a law as C for the vehicle itself; or a recording as samples for it, or as an autopilot's log.

    The C needs libm alone. Beside it are its numbers, an example that reads samples, and how to build it.
    """
    if out is None:
        raise ValueError("Missing option '--out': a directory for the C, a file for samples or a log")
    is_file = samples is not None or log is not None
    if out.exists() and not force and (is_file or not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"{out}: exists; choose another place, or --force")
    if samples is not None and log is not None:
        raise ValueError("export: expected either --samples or --log")
    # options of a law say nothing of samples or a log: they are refused, not ignored
    if is_file and (single or flies or set_ or (vehicle and log is None)):
        name = "--log takes no" if log else "--samples takes no --vehicle,"
        raise ValueError(f"export: {name} --float, --free-flight or --set")
    if log is not None:
        return _export_log(Path(law), vehicle, log, out)
    if samples is not None:
        return _export_samples(samples, topic, law, out)
    if not law or not vehicle:
        raise ValueError("export: expected LAW and --vehicle, or --samples BAG")
    from quadftc_cli.exporting import exported_law, guarded_law, write_export

    guarded = guarded_law(law, vehicle, set_, flies)
    out.mkdir(parents=True, exist_ok=True)
    say("tracing the law: some seconds")
    exported = exported_law(law, guarded, "float" if single else "double")
    write_export(exported, law, out, flies)
    say(f"{law} in C: {out}; read {out / 'README.md'}")
    return 0


def _export_log(recording: Path, vehicle: str, autopilot: Autopilot, out: Path) -> int:
    from quadftc_replay.inspection.diagnosis import read_with_layout
    from quadftc_replay.writers import WRITERS

    flown = read_with_layout(recording, vehicle)
    out.parent.mkdir(parents=True, exist_ok=True)
    names = WRITERS[autopilot.value](flown, out)
    say(f"{flown.end:.1f} s of {recording}: {out}, with {', '.join(names)}")
    return 0


def _export_samples(recording: Path, topic: str, law: str, out: Path) -> int:
    from quadftc_cli.exporting import recorded_inputs, write_recording
    from quadftc_cli.screen import warn
    from quadftc_replay.plan import read_recording

    inputs_of = recorded_inputs(law)
    found = read_recording(recording, topic)
    warn(found.warnings)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_recording(found, out, inputs_of(found))
    torque = f"torque of {found.torque_topic}" if found.driven else "no torque"
    say(f"{len(found)} samples of {found.topic}, {torque}: {out}")
    return 0
