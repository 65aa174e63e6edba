"""What goes beyond a limit in flight, for the timeline: it happened, and is no finding by itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadftc_replay.flight_log import Signal, Watched
from quadftc_replay.inspection.ending import AT_LIMIT
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.verdict import Moment
from quadftc_replay.inspection.whitening import runs_of

LASTS = 0.5  # s; manoeuvres take outputs to their limit for less
APART = 2.0  # s; shorter pauses do not end it
SHOWN = 5  # of one kind


def limit_moments(flight: Flight) -> Iterator[Moment]:
    """Say when a signal with a limit is beyond it in flight, and when a rotor has no more to give."""
    for each in (*flight.log.watched, *_outputs(flight)):
        time, value = each.signal.time, each.signal.value[:, 0]
        beyond = (value < each.limit) if each.is_least else (value > each.limit)
        beyond &= flight.in_flight(time)
        shown = 0
        for start, end, rows in _stretches(time, beyond):
            is_long = end - start >= LASTS or each.unit == "V" or each.limit == 0.0
            if is_long and shown < SHOWN:
                worst = float(value[rows].min() if each.is_least else value[rows].max())
                bound = f"{'least' if each.is_least else 'limit'} {each.limit:.3g}"
                lasted = f" for {end - start:.1f} s" if end > start else ""
                text = f"{each.name}: {worst:.3g} {each.unit}".strip() + f", {bound}{lasted}"
                yield Moment(time_s=start, source="log", text=text)
                shown += 1


def _outputs(flight: Flight) -> Iterator[Watched]:
    """Commands of rotors, none of which may be at its limit for long."""
    commands = flight.log.rotor_commands
    for rotor in range(0 if commands is None else commands.value.shape[1]):
        assert commands is not None
        signal = Signal(commands.time, np.nan_to_num(commands.value[:, rotor : rotor + 1]))
        yield Watched(f"rotor {rotor + 1} has no more to give, command", signal, AT_LIMIT)


def _stretches(time: np.ndarray, beyond: np.ndarray) -> Iterator[tuple[float, float, slice]]:
    """Begin [s], end [s] and rows of what is beyond, short pauses included."""
    runs = runs_of(beyond)
    while runs:
        first = last = runs.pop(0)
        while runs and time[runs[0].start] - time[last.stop - 1] < APART:
            last = runs.pop(0)
        yield float(time[first.start]), float(time[last.stop - 1]), slice(first.start, last.stop)
