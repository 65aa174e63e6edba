# pyright: basic
"""Rotor diagnosis in closed loop: delays, sizes, ramps, healthy flights, and faults of rotors among others.

python3 -m quadftc_tools.study.rotors --docs docs

All flights are of the X500 with the `mems` IMU and motion capture, in turbulence of any direction, in gusts
of torque of 0.5 rad/s², and with a centre of mass that is off by 5 mm. Half of them hover, half fly a circle
at 2 m/s. The rotor and all sizes are drawn. Makes the tables of docs/rotors.md, section 2.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_cli.screen import say
from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import Flight
from quadftc_flight.metrics import flight_metrics
from quadftc_model.samples import ALARMS
from quadftc_tools.study.numbers import write_number, write_per_cent, write_times
from quadftc_tools.study.page import NOTHING, Drawers, Tables, markdown, run_study
from quadftc_tools.study.rotors_flights import ONSET, RATE, Case, case_of, faulty_sensor, weak_rotor

TOLD = 64  # healthy flights after which it says how far it is
LONGER, HEALTHY = 13.0, 80.0  # s; of flights with any fault, and without one
JUDGED, FALLING = 2.0, 0.7  # s after the onset; with a rotor off, as this vehicle falls to the ground then
SEEDS = {
    "sizes": 100_000,
    "ramps": 200_000,
    "mixed": 300_000,
    "healthy": 400_000,
}
SENSORS = ("attitude", "gyro", "accelerometer")
SIZES: tuple[tuple[float, float, int], ...] = (  # smallest and largest loss; flights, of the default 200
    (0.15, 0.4, 200),
    (0.05, 0.05, 50),
    (0.075, 0.075, 50),
    (0.10, 0.10, 50),
    (0.15, 0.15, 50),
    (0.4, 0.6, 50),
    (1.0, 1.0, 100),
)
RAMPS = (0.5, 2.0, 8.0)  # s; over which 30 % are lost
# kind and channel of other faults, with what is drawn: axes, and a size between two bounds, of either sign
OTHERS = (
    ("attitude", "bias", "value", ("roll", "pitch", "yaw"), (1.0, 8.0), " deg"),
    ("gyro", "bias", "value", ("x", "y", "z", "[x, y]", "[x, y, z]"), (0.1, 0.5), " rad/s"),
    ("gyro", "stuck", "", ("x", "y", "z"), (0.0, 0.0), ""),
    ("accelerometer", "bias", "value", ("x", "y", "z"), (1.0, 3.0), ""),
)
LOSS_HEAD = (
    *("share of thrust lost", "flights", "named", "another rotor named", "a sensor named"),
    *("named after, median / largest", "error of the loss 1 s later, median / largest"),
)
RAMP_HEAD = (
    "30 % lost over",
    "flights",
    "named",
    "another rotor or a sensor named",
    "named after, median / largest",
)
MIXED_HEAD = (
    "faulty",
    "flights",
    *(f"{name} named" for name in SENSORS),
    "the rotor named",
    "another rotor named",
    "lost",
    "furthest from its place, median / worst",
    "lost without diagnosis",
    "furthest then",
)
Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]


class Said(NamedTuple):
    """What is named in a flight, after the onset of its fault; times of the first sample, infinite: never."""

    rotors: Floats  # (n,) [s] after the onset
    sensors: Floats  # (3,) [s]; attitude and gyro only where they are not ambiguous
    error: float  # estimated less true loss 1 s after it is named [1]


def fly_all(cases: Sequence[Case], scheme: str = "isolating") -> Iterator[Flight]:
    """Fly all cases, one after the other."""
    return (fly(case.scenario, scheme) for case in cases)


def hear(case: Case, flight: Flight, onset: float = ONSET, judged: float = JUDGED) -> Said:
    """Return what is named in a flight."""
    judged, rotors = FALLING if case.loss >= 1.0 else judged, np.isin(flight.rotor_state, ALARMS)
    named = [np.isin(getattr(flight, f"{name}_state"), ALARMS) for name in SENSORS]
    for place, name in enumerate(SENSORS[:2]):
        named[place] &= ~getattr(flight, f"{name}_ambiguous")
    begin, end = round(onset * RATE), round((onset + judged) * RATE)
    times = first_times(rotors[begin:end])
    error = np.nan
    if case.rotor >= 0 and np.isfinite(times[case.rotor]):
        row = min(begin + round((times[case.rotor] + 1.0) * RATE), len(rotors) - 1)
        error = 1.0 - float(flight.rotor_estimate[row, case.rotor]) - case.loss
    seen = [first_times(each[begin:end]).min() for each in named]
    return Said(times, np.array(seen), error)


def first_times(flags: Flags) -> Floats:
    """Time [s] of the first sample at which each column is true; infinite: never."""
    return np.where(flags.any(axis=0), flags.argmax(axis=0) / RATE, np.inf)


def loss_row(label: str, cases: Sequence[Case], said: Sequence[Said]) -> tuple[str, ...]:
    """Sum up flights with a weak rotor."""
    delays = np.array([each.rotors[case.rotor] for case, each in zip(cases, said, strict=True)])
    named = np.isfinite(delays)
    others = [
        np.isfinite(np.delete(each.rotors, case.rotor)).any() for case, each in zip(cases, said, strict=True)
    ]
    sensors = [np.isfinite(each.sensors).any() for each in said]
    errors = np.abs([each.error for each in said])[named]
    shares = [write_per_cent((float(np.mean(each)),)) for each in (named, others, sensors)]
    return (label, str(len(cases)), *shares, write_spread(delays[named]), write_errors(errors))


def write_spread(times: Floats) -> str:
    """Write median and largest of some times [s]."""
    return write_times((float(np.median(times)), float(times.max()))) if len(times) else NOTHING


def write_errors(errors: Floats) -> str:
    """Write median and largest of some shares."""
    return write_per_cent((float(np.median(errors)), float(errors.max()))) if len(errors) else NOTHING


def study_faults(share: float) -> dict[str, str]:
    """Fly all faults, a share of the flights that tables have by default."""
    groups: list[tuple[str, str, list[Case]]] = []

    def add(table: str, label: str, count: int, component: str, make: Any) -> None:
        seed = SEEDS[table] + 1000 * len(groups)
        cases = [case_of(seed + index, component, make) for index in range(max(1, round(share * count)))]
        groups.append((table, label, cases))

    for low, high, count in SIZES:
        size = f"{100 * low:g} to {100 * high:g} %" if high > low else f"{100 * low:g} %"
        label = "all: the rotor is off" if low >= 1.0 else size
        add("sizes", label, count, "rotor", weak_rotor(low, high))
    for rise in RAMPS:
        add("ramps", f"{rise:g} s", 50, "rotor", weak_rotor(0.3, 0.3, rise))
    heard = iter(fly_all([case for *_, cases in groups for case in cases]))
    rows: dict[str, list[tuple[str, ...]]] = {"sizes": [], "ramps": []}
    for table, label, cases in groups:
        said = [hear(case, next(heard)) for case in cases]
        rows[table].append({"sizes": loss_row, "ramps": ramp_row}[table](label, cases, said))
    heads = {"sizes": LOSS_HEAD, "ramps": RAMP_HEAD}
    return {f"rotor-{table}": markdown(heads[table], rows[table]) for table in rows}


def study_mixed(share: float) -> str:
    """Fly one fault of any component at a time, with and without diagnosis; return the table."""
    kinds = [("rotor: loss of 15 to 40 %", "rotor", weak_rotor(0.15, 0.4))]
    kinds += [(f"{other[0]}: {other[1]}", other[0], faulty_sensor(*other)) for other in OTHERS]
    count, rows = max(1, round(share * 200)), list[tuple[str, ...]]()
    groups = [
        [case_of(SEEDS["mixed"] + 1000 * kind + index, component, make, LONGER) for index in range(count)]
        for kind, (_, component, make) in enumerate(kinds)
    ]
    cases = [case for group in groups for case in group]
    flown, bare = fly_all(cases), fly_all(cases, "undiagnosed")
    for (label, *_), group in zip(kinds, groups, strict=True):
        flights = [next(flown) for _ in group]
        said = [hear(case, flight) for case, flight in zip(group, flights, strict=True)]
        held = (*holding(flights), *holding([next(bare) for _ in group]))
        rows.append((*mixed_row(label, group, said), *held))
    return markdown(MIXED_HEAD, rows)


def holding(flights: Sequence[Flight]) -> tuple[str, str]:
    """Return the share of flights that are lost, and how far the others get from their place."""
    records = [flight_metrics(flight, ()) for flight in flights]
    far = [record["position_max_m"] for record in records if not record["lost"]]
    spread = f"{np.median(far):.2f} / {max(far):.2f} m" if far else NOTHING
    return write_per_cent((float(np.mean([record["lost"] for record in records])),)), spread


def ramp_row(label: str, cases: Sequence[Case], said: Sequence[Said]) -> tuple[str, ...]:
    """Sum up flights with a rotor that weakens slowly."""
    name, flights, named, others, sensors, delays, _ = loss_row(label, cases, said)
    return name, flights, named, f"{others} / {sensors}", delays


def mixed_row(label: str, cases: Sequence[Case], said: Sequence[Said]) -> tuple[str, ...]:
    """Sum up what is named in flights with one fault of any component."""
    sensors = np.isfinite([each.sensors for each in said]).mean(axis=0)
    right = [
        case.rotor >= 0 and np.isfinite(each.rotors[case.rotor])
        for case, each in zip(cases, said, strict=True)
    ]
    wrong = [
        np.isfinite(np.delete(each.rotors, case.rotor) if case.rotor >= 0 else each.rotors).any()
        for case, each in zip(cases, said, strict=True)
    ]
    shares = (*sensors, np.mean(right), np.mean(wrong))
    return (label, str(len(cases)), *(write_per_cent((float(each),)) for each in shares))


def study_healthy(flights: int) -> str:
    """Fly without a fault; return the table of what is named all the same."""
    seed, named, sensed = SEEDS["healthy"], 0, 0
    cases = [case_of(seed + index, "", lambda _: ("", -1, 0.0), HEALTHY) for index in range(flights)]
    for number, flight in enumerate(fly_all(cases), 1):
        said = hear(cases[number - 1], flight, 0.0, HEALTHY)
        named += bool(np.isfinite(said.rotors).any())
        sensed += bool(np.isfinite(said.sensors).any())
        if number % TOLD == 0:
            say(f"{number} healthy flights: a rotor named in {named}, a sensor in {sensed}", stderr=True)
    hours = write_number(flights * HEALTHY / 3600.0)
    head = ("flights of 80 s", "hours", "flights in which a rotor is named", "a sensor")
    return markdown(head, [(str(flights), hours, str(named), str(sensed))])


def make(options: argparse.Namespace) -> tuple[Tables, Drawers]:
    """Fly all of it, and return the tables."""
    tables = study_faults(options.share) if options.share > 0.0 else {}
    if options.mixed > 0.0:
        tables["rotor-mixed"] = study_mixed(options.mixed)
    if options.healthy > 0:
        tables["rotor-healthy"] = study_healthy(options.healthy)
    return tables, {}


if __name__ == "__main__":
    shares = {
        "--share": {"type": float, "default": 1.0, "help": "of the flights with a weak rotor"},
        "--mixed": {"type": float, "default": 1.0, "help": "of the flights with any fault"},
        "--healthy": {"type": int, "default": 1000, "help": "healthy flights; 0: keep the table"},
    }
    sys.exit(run_study("rotors.md", make, shares))
