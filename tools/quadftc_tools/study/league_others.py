"""What autopilots say of their own faulty flights, beside the first finding of `quadftc diagnose`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from quadftc_replay.flight_log import Event, FlightLog
from quadftc_replay.inspection.causes import reported_failure
from quadftc_replay.inspection.diagnosis import read_with_layout
from quadftc_replay.inspection.flight import prepare
from quadftc_replay.inspection.inspect import inspect
from quadftc_tools.study.intervals import share_interval
from quadftc_tools.study.league_logs import HEALTHY, Label
from quadftc_tools.study.page import NOTHING

# seconds from the onset: the autopilot says anything, it names the component, onset that `diagnose` finds
Delays = tuple[float | None, ...]

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
OTHERS_HEADINGS = ("faulty", "autopilot says", "and names the component", "diagnose names it, onset off by")


def other_rows(labels: Mapping[Path, Label]) -> Iterator[list[str]]:
    """Yield a row for each faulty component, one for all of them, one for the healthy flights."""
    tally: dict[str, list[Delays]] = {}
    for path, label in labels.items():
        if label.component == HEALTHY or label.onset_s is None:
            continue
        log, onset = read_with_layout(path, ""), label.onset_s
        said = [event.time - onset for event in log.events if event.time >= onset]
        named = [event.time - onset for event in log.events if event.time >= onset and _names(event, label)]
        found = inspect(log).verdict.findings[:1]
        off = [abs(each.onset_s - onset) for each in found if each.component == label.component]
        delays = tuple(min(each, default=None) for each in (said, named, off))
        tally.setdefault(label.component, []).append(delays)
    for component, flights in sorted(tally.items()):
        yield [component, *(_within(column) for column in zip(*flights, strict=True))]
    faulty = zip(*itertools.chain.from_iterable(tally.values()), strict=True)
    yield ["all", *(share(sum(each is not None for each in column), len(column)) for column in faulty)]
    healthy = [read_with_layout(path, "") for path, label in labels.items() if label.component == HEALTHY]
    wrong = [sum(map(judge, healthy)) for judge in (_autopilot_fails, _diagnose_finds)]
    yield ["none", share(wrong[0], len(healthy)), NOTHING, share(wrong[1], len(healthy))]


def share(hits: int, cases: int) -> str:
    """Write a share with its exact 95 % interval."""
    low, high = share_interval(hits, cases)
    return f"{hits} of {cases}: {100.0 * hits / cases:.0f} % [{100.0 * low:.0f}, {100.0 * high:.0f}]"


def _names(event: Event, label: Label) -> bool:
    text = f"{event.source} {event.text}".lower()
    return any(word in text for word in WORDS[label.component])


def _within(delays: Sequence[float | None]) -> str:
    known = sorted({f"{each:.2f}" for each in delays if each is not None}, key=float)
    times = f", {' to '.join(known[:: len(known) - 1 or 1])} s" if known else ""
    return f"{sum(each is not None for each in delays)} of {len(delays)}{times}"


def _autopilot_fails(log: FlightLog) -> bool:
    return reported_failure(prepare(log)) is not None


def _diagnose_finds(log: FlightLog) -> bool:
    return bool(inspect(log).verdict.findings)
