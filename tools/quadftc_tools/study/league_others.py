"""What autopilots say of their own faulty flights, beside the first finding of `quadftc diagnose`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from quadftc_replay.flight_log import Event, FlightLog
from quadftc_replay.inspection.causes import reported_failure
from quadftc_replay.inspection.diagnosis import read_with_layout
from quadftc_replay.inspection.flight import prepare
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.verdict import Finding, unjudged
from quadftc_replay.readers.ulog import DETECTOR, read_contents
from quadftc_tools.study.intervals import share_interval
from quadftc_tools.study.league_logs import HEALTHY, Label
from quadftc_tools.study.page import NOTHING

# component of a label -> words by which an autopilot names it, in small letters
WORDS = {
    "accelerometer": ("accel",),
    "barometer": ("baro",),
    "battery": ("batt",),
    "gps": ("gps",),
    "gyro": ("gyro",),
    "magnetometer": ("compass", "mag"),
    "rotor": ("motor", "thrust loss"),
    "vibration": ("vibration",),
}
OTHERS_HEADINGS = ("log", "true", "autopilot says", "and names the component", "diagnose")
PX4_HEADINGS = ("log", "PX4's failure detector", "diagnose", "which could not judge")


def other_rows(labels: Mapping[Path, Label]) -> Iterator[list[str]]:
    """Yield a row for each faulty flight, one for all of them, one for the healthy ones."""
    tally = list[tuple[bool, bool, bool]]()
    healthy = [read_with_layout(path, "") for path, label in labels.items() if label.component == HEALTHY]
    for path, label in labels.items():
        if label.component == HEALTHY or label.onset_s is None:
            continue
        log = read_with_layout(path, "")
        said = [event for event in log.events if event.time >= label.onset_s]
        named = [event for event in said if _names(event, label.component)]
        found = inspect(log).verdict.findings[:1]
        is_right = bool(found) and found[0].component == label.component
        tally.append((bool(said), bool(named), is_right))
        cells = [_say(events, label.onset_s) for events in (said, named)]
        yield [path.stem, _true(label), *cells, _find(found, label.onset_s)]
    yield ["faulty", "", *(share(sum(column), len(tally)) for column in zip(*tally, strict=True))]
    wrong = [sum(map(judge, healthy)) for judge in (_autopilot_fails, _diagnose_finds)]
    yield ["healthy", "", share(wrong[0], len(healthy)), NOTHING, share(wrong[1], len(healthy))]


def px4_rows(data: Path) -> Iterator[list[str]]:
    """Yield what PX4's failure detector says in each log, and what `diagnose` says."""
    for path in sorted(data.glob("px4/**/*.ulg")):
        status = read_contents(path, (DETECTOR,)).get(DETECTOR) or {}
        raised = [name for name, flag in status.items() if name.startswith("fd_") and np.any(flag)]
        detector = ", ".join(raised) or ("silent" if status else "not logged")
        said = inspect(read_with_layout(path, "")).verdict
        found = ", ".join(f"{each.name} {each.kind}" for each in said.findings) or "no finding"
        missing = ", ".join(unjudged(said.judged, said.not_judged)) or NOTHING
        yield [path.name, detector, found, missing]


def share(hits: int, cases: int) -> str:
    """Write a share with its exact 95 % interval."""
    low, high = share_interval(hits, cases)
    return f"{hits} of {cases}: {100.0 * hits / cases:.0f} % [{100.0 * low:.0f}, {100.0 * high:.0f}]"


def _names(event: Event, component: str) -> bool:
    text = f"{event.source} {event.text}".lower()
    return any(word in text for word in WORDS[component])


def _true(label: Label) -> str:
    return f"{label.component} {label.element or ''}".rstrip()


def _say(events: Sequence[Event], onset: float) -> str:
    if not events:
        return NOTHING
    first = [event for event in events if event.time == events[0].time][-1]  # MSG comes after ERR and EV
    return f"{first.time - onset:.2f} s: {first.text}"


def _find(found: Sequence[Finding], onset: float) -> str:
    return f"{found[0].name} {found[0].kind}, {found[0].onset_s - onset:+z.2f} s" if found else NOTHING


def _autopilot_fails(log: FlightLog) -> bool:
    return reported_failure(prepare(log)) is not None


def _diagnose_finds(log: FlightLog) -> bool:
    return bool(inspect(log).verdict.findings)
