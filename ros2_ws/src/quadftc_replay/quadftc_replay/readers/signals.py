"""Signals of a log as its reader found them: cleaned of bad stamps, then put on one time axis."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadftc_bags.bag import BagError
from quadftc_model.arrays import AnyArray
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_replay.flight_log import Event, FlightLog, Floats, Signal, Watched
from quadftc_replay.readers.layouts import Layout

Stamps = NDArray[np.int64]
DEGREE, RPM, MILLI = math.pi / 180.0, math.pi / 30.0, 1e-3  # rad; rad/s; 1
MAX_PAUSE = 3600.0  # s; what is further from the other samples than this has a damaged stamp
LARGEST = 1e9  # of a parameter, and of a measurement in SI
NAMED = (
    *("gyros", "accelerometers", "magnetometers", "barometers"),
    *("gps_positions", "gps_velocities", "gps_status"),
)  # fields of which a log may have several
MOST_EVENTS, LONGEST_EVENT = 500, 120  # of a log; characters
MOST_LOST = 0.05  # 1; share of the samples of a signal, beyond which the log is not whole
CUT = ("cut short", "cut or damaged", "damaged; read")  # words of a reader that did not get to the end
REPEATS = 10  # events before, of which a new one is no repetition
COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # what sets the colour of a terminal


class Stamped(NamedTuple):
    """Samples on the clock of the log."""

    stamp_ns: Stamps  # (n,) strictly increasing
    value: Floats  # (n, k)


class Signals:
    """Collects the signals of one log; `flight_log` puts them together."""

    def __init__(self, path: Path, format_name: str) -> None:
        self.path, self.format = path, format_name
        self.notes: list[str] = []
        self._named: dict[str, dict[str, Stamped]] = {kind: {} for kind in NAMED}
        self._single: dict[str, Stamped] = {}
        self._events: list[tuple[int, str, str]] = []
        self._watched: list[tuple[Watched, Stamped]] = []
        self._lost = ""  # what most is left out of

    def say(self, stamp_ns: int, source: str, text: str) -> None:
        """Take what the autopilot said; what it repeats counts once, and control characters do not count."""
        plain = "".join(each if each.isprintable() else " " for each in COLOUR.sub("", text))
        line = " ".join(plain.split())[:LONGEST_EVENT]
        is_new = not any(each[1:] == (source, line) for each in self._events[-REPEATS:])
        if line and is_new and len(self._events) < MOST_EVENTS:
            self._events.append((int(stamp_ns), source, line))

    def watch(
        self,
        name: str,
        stamp_ns: Stamps,
        value: ArrayLike,
        limit: float,
        unit: str = "",
        is_least: bool = False,
    ) -> None:
        """Take a signal (n,) that has a limit."""
        rows, _ = measured(np.asarray(value, np.float64).reshape(len(stamp_ns), 1))
        kept, _ = good_stamps(stamp_ns)
        if len(kept) > 1:
            signal = Stamped(_take(stamp_ns, kept), _take(rows, kept))
            untimed = Signal(np.zeros(0), np.zeros((0, 1)))
            self._watched.append((Watched(name, untimed, limit, unit, is_least), signal))

    def add(self, field: str, stamp_ns: Stamps, value: ArrayLike, source: str, name: str = "") -> bool:
        """Take a signal for a field of `FlightLog`; whether two samples or more are left of it.

        ``source`` is its name in the log, for notes; ``name`` tells several of a kind apart.
        """
        rows, damaged = measured(np.asarray(value, np.float64).reshape(len(stamp_ns), -1))
        if damaged:
            self.notes.append(f"{source}: {damaged} values beyond {LARGEST:g} left out")
        kept = np.flatnonzero(np.isfinite(rows).any(axis=1))
        chosen, complaint = good_stamps(_take(stamp_ns, kept))
        kept = _take(kept, chosen)
        if complaint:
            self.notes.append(f"{source}: {complaint}")
            if len(kept) < (1.0 - MOST_LOST) * len(stamp_ns):
                self._lost = self._lost or self.notes[-1]
        if len(kept) < 2:
            if len(stamp_ns):
                self.notes.append(f"{source}: {len(kept)} usable samples; left out")
            return False
        signal = Stamped(_take(stamp_ns, kept), _take(rows, kept))
        if field in self._named:
            self._named[field][name] = signal
        else:
            self._single[field] = signal
        return True

    def has(self, field: str) -> bool:
        """Whether there is a signal for a field."""
        return bool(self._named.get(field)) or field in self._single

    def names(self, field: str) -> list[str]:
        """Names of the signals of a kind."""
        return list(self._named[field])

    def flight_log(self, layout: Layout | None = None, is_own: bool = False, **known: Any) -> FlightLog:
        """Put everything together; BagError if there is no signal at all.

        ``is_own``: the attitude is computed from a gyro of the log.
        """
        if layout is not None:
            known |= {"rotor_positions": layout.positions, "rotor_yaw_signs": layout.yaw_signs}
        if is_own and self.has("attitude"):
            known["attitude_from_gyro"] = True
        self._leave_out_other_times()
        everything = list(self._all())
        if not everything:
            wanted = "a gyro, an attitude, motor commands or speeds"
            more = "".join(f"; {note}" for note in self.notes)
            raise BagError(f"{self.path}: {self.format} log without a usable signal; expected {wanted}{more}")
        start_ns = min(int(signal.stamp_ns[0]) for _, _, signal in everything)

        def timed(signal: Stamped) -> Signal:
            return Signal((signal.stamp_ns - start_ns) / NANOSECONDS_PER_SECOND, signal.value)

        fields: dict[str, Any] = {name: timed(signal) for name, signal in self._single.items()}
        for kind, signals in self._named.items():
            fields[kind] = {name: timed(signal) for name, signal in signals.items()}
        return FlightLog(
            path=self.path,
            format=self.format,
            start_ns=start_ns,
            incomplete=self._lost
            or next((each for each in self.notes if any(word in each for word in CUT)), ""),
            watched=tuple(each._replace(signal=timed(signal)) for each, signal in self._watched),
            events=tuple(self._said(start_ns, max(int(each.stamp_ns[-1]) for _, _, each in everything))),
            notes=tuple(self.notes),
            **fields,
            **{name: value for name, value in known.items() if value is not None},
        )

    def _said(self, start_ns: int, end_ns: int) -> Iterable[Event]:
        """What was said from the first to the last sample, in order."""
        for stamp_ns, source, text in sorted(self._events):
            if start_ns <= stamp_ns <= end_ns:
                yield Event((stamp_ns - start_ns) / NANOSECONDS_PER_SECOND, source, text)

    def _all(self) -> Iterable[tuple[dict[str, Stamped], str, Stamped]]:
        for holder in (self._single, *self._named.values()):
            for name, signal in holder.items():
                yield holder, name, signal

    def _leave_out_other_times(self) -> None:
        """Leave out signals on another clock than the one with most samples."""
        if not (signals := [signal for *_, signal in self._all()]):
            return
        longest = max(signals, key=lambda each: len(each.stamp_ns))
        margin = int(MAX_PAUSE * NANOSECONDS_PER_SECOND)
        first, last = int(longest.stamp_ns[0]) - margin, int(longest.stamp_ns[-1]) + margin
        for holder, name, signal in list(self._all()):
            if int(signal.stamp_ns[-1]) < first or int(signal.stamp_ns[0]) > last:
                del holder[name]
                self.notes.append(f"{name or 'main sensor'}: its stamps are of another clock; left out")


def measured(rows: Floats) -> tuple[Floats, int]:
    """Put NaN for values that no sensor gives, infinity among them; say for how many."""
    damaged = np.abs(rows) >= LARGEST
    count = int(np.sum(damaged))
    return (np.where(damaged, np.nan, rows) if count else rows), count


def _take(values: AnyArray, rows: NDArray[np.intp]) -> AnyArray:
    """Rows of an array; the array itself if they are all of it."""
    return values if len(rows) == len(values) else values[rows]


def good_stamps(stamp_ns: Stamps) -> tuple[NDArray[np.intp], str]:
    """Choose rows with stamps that increase, near each other; say in words what was left out.

    The longest increasing run of stamps is kept, so that one damaged stamp costs one sample.
    """
    if not len(stamp_ns):
        return np.zeros(0, np.intp), ""
    rows = np.arange(len(stamp_ns))
    if bool(np.any(np.diff(stamp_ns) <= 0)):
        rows = _longest_increasing(stamp_ns)
    pauses = np.diff(stamp_ns[rows]) > MAX_PAUSE * NANOSECONDS_PER_SECOND
    if bool(np.any(pauses)):
        rows = max(np.split(rows, np.flatnonzero(pauses) + 1), key=len)
    lost = len(stamp_ns) - len(rows)
    return rows, f"{lost} of {len(stamp_ns)} samples with a stamp out of order left out" if lost else ""


def _longest_increasing(stamp_ns: Stamps) -> NDArray[np.intp]:
    """Rows of the longest strictly increasing subsequence (patience sorting)."""
    tops: list[int] = []  # smallest stamp that ends a subsequence of this length
    at: list[int] = []  # its row
    before = np.full(len(stamp_ns), -1, np.intp)
    for row, stamp in enumerate(stamp_ns.tolist()):
        if not tops or stamp > tops[-1]:
            place = len(tops)
            tops.append(stamp)
            at.append(row)
        else:
            place = bisect_left(tops, stamp)
            tops[place], at[place] = stamp, row
        if place:
            before[row] = at[place - 1]
    chosen = np.empty(len(tops), np.intp)
    row = at[-1]
    for place in range(len(tops) - 1, -1, -1):
        chosen[place] = row
        row = int(before[row])
    return chosen


def columns(data: Mapping[str, AnyArray], names: Iterable[str]) -> Floats:
    """Stack columns of a table (n, k)."""
    arrays = [data[name] for name in names]
    with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
        return np.stack(arrays, axis=-1, dtype=np.float64, casting="unsafe")


def sound(parameters: Mapping[str, object]) -> dict[str, float]:
    """Keep the parameters that are numbers of a sensible size; others are damaged."""
    return {
        name: float(value)
        for name, value in parameters.items()
        if isinstance(value, (int, float)) and abs(value) < LARGEST  # False for NaN, too
    }


def thrust_of_throttle(throttle: Floats, curve: float) -> Floats:
    """Share of the greatest thrust of a share of the throttle r: (1 - c) r + c r².

    c is MOT_THST_EXPO of ArduPilot or THR_MDL_FAC of PX4.
    """
    factor = min(max(curve, -1.0), 1.0)
    return (1.0 - factor) * throttle + factor * throttle**2
