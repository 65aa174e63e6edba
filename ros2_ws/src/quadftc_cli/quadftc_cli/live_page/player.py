# pyright: basic
"""``quadftc live --bag``: a recorded flight plays into the pictures of its vehicles, in the page's process.

Times [s] are those of the flight, since its first IMU sample.
"""

from __future__ import annotations

import asyncio
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import yaml

from quadftc_bags.bag import Bag, BagError, bag_topics, read_bag
from quadftc_cli.live_page.charts import WINDOW
from quadftc_cli.live_page.feed import DIAGNOSTICS, PERIOD, SHOWN, Flown, Frame
from quadftc_cli.live_page.picture import Picture
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import flight_from_bag
from quadftc_flight.live_run import VEHICLE, events_of, flight_times, rotor_events_of, with_kinds
from quadftc_flight.run_directory import (
    NO_PARAMETERS,
    PARAMETERS,
    SCENARIO,
    attached_text,
    find_run,
    parse_parameters,
    run_name,
)
from quadftc_ros.topics import GRAPHS, TOPICS
from quadftc_sim.injection import TRUTH as INJECTED

T = TypeVar("T")

SAMPLES = "imu/data"
# topics that tell which faults were injected, and of how many rotors
TRUTH = (*INJECTED.values(), "rotors/fault", "rotors/speed")


class Recorded(NamedTuple):
    """What a bag says of a vehicle; times since the first IMU sample of any vehicle in it."""

    flown: Flown
    begin_ns: int  # stamp of that sample
    times: list[float]  # of the messages, rising [s]
    messages: list[tuple[str, bytes]]  # topic, relative to the namespace, and data
    events: tuple[FaultEvent, ...]  # the faults that were injected
    warnings: tuple[str, ...]  # one line each


def read_recorded(path: Path, namespace: str = "") -> list[Recorded]:
    """Read all vehicles of a bag, or of the folder of one flight; of a ``namespace`` its vehicle alone.

    A `BagError` says in one line why the page cannot play it.
    """
    bag = read_bag(find_run(path), [*SHOWN, *TRUTH, DIAGNOSTICS])
    vehicles = [_vehicle_of(bag, prefix) for prefix in _prefixes_of(bag, namespace)]
    begin_ns = min(each.begin_ns for each in vehicles)
    return [_since(begin_ns, each) for each in vehicles]


def _vehicle_of(bag: Bag, prefix: str) -> Recorded:
    """Return the vehicle whose topics have a prefix; times since its own first sample."""
    names = {name: name if name == DIAGNOSTICS else name.removeprefix(prefix) for name in bag.topics}
    topics = {
        name: short
        for name, short in names.items()
        if short in TOPICS and TOPICS[short].type_name == bag.topics[name].type_name
    }
    samples = bag.series(prefix + SAMPLES)
    rows = list(bag.messages(topics))
    log_ns = np.array([time_ns for _, time_ns, _ in rows], np.int64)
    times = np.maximum.accumulate(flight_times(log_ns, samples.log_time_ns, samples.stamp_ns))
    if not times[-1] > 0.0:
        raise BagError(f"{bag.path}: {len(samples)} samples at one moment on {prefix}{SAMPLES}")
    flown = _flown(bag, {*topics.values()}, len(samples) / times[-1])._replace(namespace=prefix.strip("/"))
    warnings = [f"{bag.path}: cut short; played up to there{bag.remedy}"] if bag.truncated else []
    if not flown.vehicle:
        flown = flown._replace(vehicle=VEHICLE)
        warnings.append(f"{bag.path}: says of no vehicle; drawn as {VEHICLE}")
    return Recorded(
        flown,
        int(samples.stamp_ns[0]),
        times.tolist(),
        [(topics[name], data) for name, _, data in rows],
        _events_of(bag, topics),
        tuple(warnings),
    )


def _since(begin_ns: int, vehicle: Recorded) -> Recorded:
    """Count the times of a vehicle from a stamp."""
    late = (vehicle.begin_ns - begin_ns) * 1e-9
    events = (each._replace(start=each.start + late, stop=each.stop + late) for each in vehicle.events)
    times = [late + time for time in vehicle.times]
    return vehicle._replace(begin_ns=begin_ns, times=times, events=tuple(events))


def _events_of(bag: Bag, topics: Mapping[str, str]) -> tuple[FaultEvent, ...]:
    """Return the faults that were injected; ``topics`` of the bag by their full names."""
    needed = (SAMPLES, *TRUTH, DIAGNOSTICS)
    part = copy(bag)
    part.topics = {name: bag.topics[name] for name, short in topics.items() if short in needed}
    flight = flight_from_bag(part)
    events = with_kinds(part, (*events_of(flight), *rotor_events_of(flight)))
    return tuple(sorted(events, key=lambda event: event.start))


def _prefixes_of(bag: Bag, namespace: str) -> list[str]:
    """Return what stands before the names of each vehicle's topics; BagError where none has IMU samples."""
    wanted = f"{namespace.strip('/')}/{SAMPLES}".lstrip("/")
    found = [
        name.removesuffix(SAMPLES)
        for name, topic in bag.topics.items()
        if f"/{name}".endswith(f"/{wanted}") and topic.count and topic.type_name == TOPICS[SAMPLES].type_name
    ]
    if not found:
        there = ", ".join(sorted(name for name, each in bag_topics(bag.path).items() if each.count)) or "none"
        missing = f"no message on {wanted} ({TOPICS[SAMPLES].type_name})"
        raise BagError(f"{bag.path}: {missing}; topics there: {there}{bag.remedy}")
    return sorted(found)


def _flown(bag: Bag, topics: set[str], rate: float) -> Flown:
    """Return what flew, as far as the files in and beside the bag tell."""
    parameters = _parsed(bag, PARAMETERS, parse_parameters)
    scenario = _parsed(bag, SCENARIO, lambda text: dict(yaml.safe_load(text)))
    flying, watching = (parameters.get(node, {}) for node in ("controller", "fault_observer"))
    vehicle = _text(flying, "vehicle") or _text(watching, "vehicle") or _text(scenario, "vehicle")
    said = {"observer": _text(watching, "observer"), "controller": _text(flying, "controller")}
    parts = [f"{role} {name}" for role, name in said.items() if name]
    return Flown(
        title=_text(scenario, "description") or _text(scenario, "name") or run_name(bag.path),
        parts=", ".join(filter(None, (Path(vehicle).stem, *parts, f"{rate:.0f} Hz, recorded"))),
        vehicle=vehicle,
        plant="free_flight" if topics - {*GRAPHS["test_stand"]} else "test_stand",
        simulated=False,
    )


def _text(values: Mapping[str, object], key: str) -> str:
    """Return a text; empty if it is missing, or no text."""
    value = values.get(key)
    return value if isinstance(value, str) else ""


def _parsed(bag: Bag, name: str, parse: Callable[[str], dict[str, T]]) -> dict[str, T]:
    """Return what a file of the bag says; nothing where it is missing, BagError if it makes no sense."""
    text = attached_text(bag, name)
    try:
        return parse(text) if text is not None else {}
    except NO_PARAMETERS:
        raise BagError(f"{bag.path}: {name} makes no sense") from None


class Player:
    """Where a recorded flight is, and whether it goes on; all its vehicles are at the same time."""

    def __init__(self, vehicles: Sequence[Recorded], pictures: Sequence[Picture], speed: float) -> None:
        self.duration = max(each.times[-1] for each in vehicles)
        self.speed, self.playing = speed, True
        self.time = 0.0
        self.wanted: float | None = None  # time to go to, which the charts show with what was before
        rows = [
            (time, number, *message)
            for number, each in enumerate(vehicles)
            for time, message in zip(each.times, each.messages, strict=True)
        ]
        self._rows, self._next = sorted(rows, key=itemgetter(0)), 0
        self._times = [row[0] for row in self._rows]
        self._pictures = pictures
        for picture, each in zip(pictures, vehicles, strict=True):
            picture.begin_ns = each.begin_ns
            picture.silent = frozenset(SHOWN) - {topic for topic, _ in each.messages}

    async def run(self) -> None:
        """Play in real time, until cancelled."""
        last = time.monotonic()
        while True:
            await asyncio.sleep(PERIOD)
            passed, last = time.monotonic() - last, time.monotonic()
            self.step(passed)

    def step(self, passed: float) -> None:
        """Go where it is wanted, or, if it plays, go on by a time of the clock [s]; it stops at the end."""
        if self.wanted is not None:
            self._seek(self.wanted)
        elif self.playing:
            self._show(min(self.time + self.speed * passed, self.duration))
            self.playing = self.time < self.duration

    def toggle(self) -> None:
        """Play or pause; at the end, play from the beginning."""
        if self.time >= self.duration:
            self.wanted = 0.0
        self.playing = not self.playing

    def _seek(self, moment: float) -> None:
        moment, self.wanted = min(max(moment, 0.0), self.duration), None
        for picture in self._pictures:
            picture.forget()
        self.time = max(0.0, moment - WINDOW)
        self._next = bisect_left(self._times, self.time)
        self._show(moment)

    def _show(self, moment: float) -> None:
        """Give the pictures what comes up to a time [s], in frames as of a flight."""
        while True:
            self.time = min(self.time + PERIOD, moment)
            end = bisect_right(self._times, self.time, self._next)
            frames = [Frame({}, []) for _ in self._pictures]
            for _, number, topic, data in self._rows[self._next : end]:
                if topic == DIAGNOSTICS:
                    frames[number].diagnostics.append(data)
                else:
                    frames[number].last[topic] = data
            self._next = end
            for picture, frame in zip(self._pictures, frames, strict=True):
                picture.take(frame)
            if self.time >= moment:
                return
