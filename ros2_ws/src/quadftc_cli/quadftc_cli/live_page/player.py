# pyright: basic
"""``quadftc live --bag``: a recorded flight that plays into a picture, in the process of the page.

Times [s] are those of the flight, since its first IMU sample.
"""

from __future__ import annotations

import asyncio
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping
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
    find_runs,
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
    """A bag as the page needs it."""

    flown: Flown
    begin_ns: int  # stamp of the first sample
    times: list[float]  # of the messages, rising [s]
    messages: list[tuple[str, bytes]]  # topic, relative to the namespace, and data
    events: tuple[FaultEvent, ...]  # the faults that were injected
    warnings: tuple[str, ...]  # one line each


def read_recorded(path: Path, namespace: str = "") -> Recorded:
    """Read a bag, or the folder of one flight; a `BagError` says in one line why the page cannot play it."""
    found = find_runs([path])
    if len(found) > 1:
        raise BagError(f"{path}: holds {len(found)} flights; give one of them, such as {found[0]}")
    bag = read_bag(found[0], [*SHOWN, *TRUTH, DIAGNOSTICS])
    prefix = _prefix_of(bag, namespace)
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
    flown = _flown(bag, {*topics.values()}, len(samples) / times[-1])
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


def _events_of(bag: Bag, topics: Mapping[str, str]) -> tuple[FaultEvent, ...]:
    """Return the faults that were injected; ``topics`` of the bag by their full names."""
    needed = (SAMPLES, *TRUTH, DIAGNOSTICS)
    bag.topics = {name: bag.topics[name] for name, short in topics.items() if short in needed}
    flight = flight_from_bag(bag)
    events = with_kinds(bag, (*events_of(flight), *rotor_events_of(flight)))
    return tuple(sorted(events, key=lambda event: event.start))


def _prefix_of(bag: Bag, namespace: str) -> str:
    """Return what stands before the names of the vehicle's topics; BagError without its IMU samples."""
    wanted = f"{namespace}/{SAMPLES}".lstrip("/").replace("//", "/")
    try:
        full = bag.resolve(wanted)
    except BagError as error:
        if "more than one" in str(error):
            raise BagError(f"{error}; --namespace chooses one") from None
        full = ""
    topic = bag.topics.get(full)
    if topic is None or not topic.count or topic.type_name != TOPICS[SAMPLES].type_name:
        there = ", ".join(sorted(name for name, each in bag_topics(bag.path).items() if each.count)) or "none"
        missing = f"no message on {wanted} ({TOPICS[SAMPLES].type_name})"
        raise BagError(f"{bag.path}: {missing}; topics there: {there}{bag.remedy}")
    return full.removesuffix(SAMPLES)


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
    """Where a recorded flight is, and whether it goes on."""

    def __init__(self, recorded: Recorded, picture: Picture, speed: float) -> None:
        self.events, self.duration = recorded.events, recorded.times[-1]
        self.speed, self.playing = speed, True
        self.time = 0.0
        self.wanted: float | None = None  # time to go to, which the charts show with what was before
        self._times, self._messages, self._next = recorded.times, recorded.messages, 0
        self._picture = picture
        picture.begin_ns = recorded.begin_ns
        picture.silent = frozenset(SHOWN) - {topic for topic, _ in recorded.messages}

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
        self._picture.forget()
        self.time = max(0.0, moment - WINDOW)
        self._next = bisect_left(self._times, self.time)
        self._show(moment)

    def _show(self, moment: float) -> None:
        """Give the picture what comes up to a time [s], in frames as of a flight."""
        while True:
            self.time = min(self.time + PERIOD, moment)
            end = bisect_right(self._times, self.time, self._next)
            frame = Frame({}, [])
            for topic, data in self._messages[self._next : end]:
                if topic == DIAGNOSTICS:
                    frame.diagnostics.append(data)
                else:
                    frame.last[topic] = data
            self._next = end
            self._picture.take(frame)
            if self.time >= moment:
                return
