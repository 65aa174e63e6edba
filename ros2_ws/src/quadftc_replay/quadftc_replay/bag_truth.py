"""What a bag says of the faults that are in its samples already: how large they are, and when."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from quadftc_bags.bag import Bag
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow, events_of_windows
from quadftc_flight.run_directory import SCENARIO, attached_text
from quadftc_flight.scenario import Scenario, ScenarioError, parse_scenario
from quadftc_model.samples import AXES
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_replay.recording import Floats, Stamps

TRUTH = {
    "attitude": "fault/injected",
    "gyro": "fault/injected/gyro",
    "accelerometer": "fault/injected/accelerometer",
}  # channel -> topic of the true fault
DROPPED = "fault/dropped"
PAUSE = 1.0  # s; a fault that pauses for less is one fault


def recorded_faults(bag: Bag, topics: Collection[str], namespace: str, stamp_ns: Stamps) -> dict[str, Floats]:
    """Recorded true faults on the rows of the samples (n, 3); of several with one stamp, the first counts.

    Parameters
    ----------
    bag : Bag
    topics : collection of str
        Full names of those that were read.
    namespace : str
        Of the vehicle, with its slashes.
    stamp_ns : array (n,)
        Of the samples.
    """
    faults: dict[str, Floats] = {}
    for channel, topic in TRUTH.items():
        if f"{namespace}{topic}" not in topics:
            continue
        series = bag.series(f"{namespace}{topic}")
        stamps, first = np.unique(series.stamp_ns, return_index=True)
        column = np.full((len(stamp_ns), 3), np.nan)
        _, here, there = np.intersect1d(stamp_ns, stamps, assume_unique=True, return_indices=True)
        column[here] = series["vector"][first[there]]
        faults[channel] = column
    return faults


def fault_windows(
    bag: Bag, topics: Collection[str], namespace: str, stamp_ns: Stamps, faults: Mapping[str, Floats]
) -> tuple[FaultWindow, ...]:
    """When the attitude is faulty: by the schedule of the attached scenario, else by the recorded fault.

    Times are counted from the first sample. For the arguments see `recorded_faults`, which gives ``faults``.
    """
    if "attitude" not in faults:
        return ()
    scenario = _scenario(bag)
    if scenario is None:
        return windows_of(stamp_ns, faults["attitude"])
    late = _late(bag, topics, namespace, stamp_ns)
    return tuple(
        FaultWindow(max(0.0, start - late), stop - late, axes)
        for start, stop, axes in scenario.fault_windows
        if stop > late
    )


def recorded_events(
    bag: Bag, topics: Collection[str], namespace: str, stamp_ns: Stamps, faults: Mapping[str, Floats]
) -> tuple[FaultEvent, ...]:
    """Faults of the attitude axis by axis, with their kind; as `fault_windows`."""
    if "attitude" not in faults:
        return ()
    scenario = _scenario(bag)
    if scenario is None:
        return events_of_windows(windows_of(stamp_ns, faults["attitude"]))
    late = _late(bag, topics, namespace, stamp_ns)
    return tuple(
        event._replace(start=max(0.0, event.start - late), stop=event.stop - late)
        for event in scenario.fault_events
        if event.stop > late
    )


def windows_of(stamp_ns: Stamps, fault: Floats) -> tuple[FaultWindow, ...]:
    """When a fault (n, 3) acts: a window for each time without a pause longer than ``PAUSE``."""
    acts = fault != 0.0  # true for NaN, too
    rows = np.flatnonzero(acts.any(axis=1))
    if not len(rows):
        return ()
    time = (stamp_ns - stamp_ns[0]) / NANOSECONDS_PER_SECOND
    breaks = np.flatnonzero(np.diff(time[rows]) > PAUSE) + 1
    windows: list[FaultWindow] = []
    for part in np.split(rows, breaks):
        stop = time[min(int(part[-1]) + 1, len(time) - 1)]
        axes = tuple(axis for axis, on in zip(AXES, acts[part].any(axis=0), strict=True) if on)
        windows.append(FaultWindow(float(time[part[0]]), float(stop), axes))
    return tuple(windows)


def _late(bag: Bag, topics: Collection[str], namespace: str, stamp_ns: Stamps) -> float:
    """How long after the start of the flight the first sample is [s]: those before were withheld."""
    dropped = f"{namespace}{DROPPED}"
    first_ns = int(bag.series(dropped).stamp_ns.min()) if dropped in topics else int(stamp_ns[0])
    return max(0.0, float(stamp_ns[0] - first_ns) / NANOSECONDS_PER_SECOND)


def _scenario(bag: Bag) -> Scenario | None:
    text = attached_text(bag, SCENARIO)
    if text is None:
        return None
    try:
        return parse_scenario(text, f"{bag.path}: {SCENARIO}")
    except ScenarioError:
        return None
