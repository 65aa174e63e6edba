"""Magnetometers, barometers and satellite receivers: those that stop or repeat, and those that jump.

A reading that is repeated is a fault where the sensor otherwise never does so. A magnetometer has to have
been turned meanwhile, as the field of a vehicle that keeps its attitude hardly moves, or another one changes.
The height of a vehicle that hovers hardly moves, but a barometer that is alive has the noise of the air.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.agreement import Agreement
from quadftc_replay.inspection.compass import Field, compass_findings
from quadftc_replay.inspection.flight import Flight, Interval
from quadftc_replay.inspection.found import BODY_AXES, Curve, Found, component_name, make_found
from quadftc_replay.inspection.heights import (
    BAROMETER,
    barometer_findings,
    receiver_findings,
    velocity_findings,
)
from quadftc_replay.inspection.readings import absent_findings, quiet_intervals, stuck_intervals

CHANGES = 30  # of another magnetometer, of which this one shows none: by chance once in 2^30


def navigation_findings(
    flight: Flight, agreement: Agreement | None, other: Signal | None, fields: Mapping[str, Field]
) -> tuple[list[Found], list[str]]:
    """Return what is found, and which components were judged; ``other`` is a signal that goes on longest."""
    log = flight.log
    sensors: dict[str, Mapping[str, Signal]] = {
        "magnetometer": log.magnetometers,
        "barometer": log.barometers,
        "gps": log.gps_positions,
    }
    found: list[Found] = []
    for kind, each in sensors.items():
        for name, sensor in each.items():
            component = component_name(kind, name)
            found += absent_findings(flight, component, sensor, other)
            others = [one for other, one in each.items() if other != name]
            found += _stuck(flight, component, sensor, fields.get(name), others)
    found += compass_findings(flight, agreement, fields)
    judged = ["magnetometer"] if fields else []
    for kind, (jumps, is_judged) in (
        ("barometer", barometer_findings(flight)),
        ("gps", receiver_findings(flight)),
    ):
        found += jumps
        judged += [kind] if is_judged else []
    found += velocity_findings(flight)
    return found, judged


def _stuck(
    flight: Flight, component: str, sensor: Signal, field: Field | None, others: Sequence[Signal]
) -> Iterator[Found]:
    """Say when a sensor repeats all of its reading at once; ``others`` are of its kind."""
    _, alike = np.unique(sensor.value, axis=0, return_inverse=True)
    is_compass = component.startswith("magnetometer")
    stretches = [
        each
        for each in stuck_intervals(flight, sensor.time, alike.ravel().astype(float))
        if each.start > sensor.time[0]
        and (
            not is_compass
            or (field is not None and field.turns(each))
            or any(_changes(other, each) > CHANGES for other in others)
        )
    ]
    turns = "while the vehicle turns in the field of the earth, or another changes"
    what = f"repeats its reading, {turns if is_compass else 'as it does not otherwise'}"
    if not stretches and component.startswith(BAROMETER):
        stretches, what = quiet_intervals(flight, sensor), "has next to none of its usual noise"
    if not stretches:
        return
    first, last = stretches[0], stretches[-1]
    said = f"it {what}, for {sum(each.end - each.start for each in stretches):.3g} s"
    for column, element in enumerate(BODY_AXES if is_compass else ("",)):
        lines = {"reading": sensor.value[:, column]}
        yield make_found(
            *(component, element, "stuck", first.start),
            end_s=None if last.end >= float(sensor.time[-1]) else last.end,
            evidence=(said,),
            curve=Curve(f"{component} {element}", "", sensor.time, lines),
            is_direct=True,
        )


def _changes(sensor: Signal, stretch: Interval) -> int:
    """How often a sensor changes its reading in a stretch of time."""
    rows = slice(*np.searchsorted(sensor.time, stretch))
    return int(np.any(np.diff(sensor.value[rows], axis=0) != 0.0, axis=1).sum())
