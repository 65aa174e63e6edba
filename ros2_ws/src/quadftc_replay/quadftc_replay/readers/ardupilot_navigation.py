"""Magnetometers, barometers and satellite receivers of an ArduPilot log.

Since version 4.0 one message tells them apart by a field; before, each had a message of its own. What the
autopilot itself holds of their health goes to the events.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from quadftc_model.frames import flu_from_frd
from quadftc_replay.readers.ardupilot_tables import Table, at, instances_of, stamps_of
from quadftc_replay.readers.positioning import Fixes, add_receiver
from quadftc_replay.readers.signals import Signals, columns

MAGNETOMETERS, BAROMETERS = ("MAG", "MAG2", "MAG3"), ("BARO", "BAR2", "BAR3")
RECEIVERS, ACCURACIES = ("GPS", "GPS2"), ("GPA", "GPA2")
_FIELD, _MOTION = ("MagX", "MagY", "MagZ"), ("Lat", "Lng", "Alt", "Spd", "GCrs", "VZ")


def add_navigation(signals: Signals, messages: Mapping[str, Table]) -> None:
    """Add every magnetometer, barometer and satellite receiver."""
    for name, source, table in _each(messages, MAGNETOMETERS, *_FIELD):
        field = flu_from_frd(columns(table, _FIELD))
        if np.any(field):
            signals.add("magnetometers", stamps_of(table), field, source, name)
            _add_health(signals, table, source)
    for name, source, table in _each(messages, BAROMETERS, "Alt"):
        signals.add("barometers", stamps_of(table), table["Alt"], source, name)
        _add_health(signals, table, source)
    accuracies = {name: table for name, _, table in _each(messages, ACCURACIES, "HAcc")}
    for name, source, table in _each(messages, RECEIVERS, *_MOTION):
        latitude, longitude, height, speed, course, down = columns(table, _MOTION).T
        stamp_ns, course = stamps_of(table), np.radians(course)
        unknown = np.full(len(stamp_ns), np.nan)
        claims = accuracies.get(name)
        said = Fixes(
            *(latitude, longitude, height),
            velocity=np.stack([speed * np.sin(course), speed * np.cos(course), -down], axis=-1),
            fix=np.asarray(table.get("Status", unknown), np.float64),
            satellites=np.asarray(table.get("NSats", unknown), np.float64),
            accuracy=at(stamp_ns, claims, "HAcc") if claims else unknown,
        )
        add_receiver(signals, stamp_ns, said, source, name)


def _each(messages: Mapping[str, Table], names: Sequence[str], *fields: str) -> list[tuple[str, str, Table]]:
    """Every sensor of a kind: its name (the first has none), its name in the log, its samples."""
    found = instances_of(messages.get(names[0]), *fields)
    for number, name in enumerate(names[1:], 1):
        if number not in found and (table := instances_of(messages.get(name), *fields).get(0)):
            found[number] = table
    order = sorted(found.items())
    return [
        ("" if number == order[0][0] else str(number), f"{names[0]} {number}", table)
        for number, table in order
    ]


def _add_health(signals: Signals, table: Table, source: str) -> None:
    """Say when the autopilot takes a sensor for unhealthy, and when no more."""
    health = next((table[name] for name in ("Health", "H") if name in table), None)
    if health is None:
        return
    stamp_ns, healthy = stamps_of(table), health > 0
    for row in np.flatnonzero(np.diff(healthy, prepend=True)).tolist():
        signals.say(int(stamp_ns[row]), source, "healthy" if healthy[row] else "unhealthy")
