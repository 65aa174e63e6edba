"""Joining messages by stamp: in lock-step a node waits until everything of one sample is there."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np

from quadftc_model.parameters import parameter
from quadftc_model.samples import PositionSample, is_usable
from quadftc_model.stepper import seconds
from quadftc_ros.conversions import Floats

M = TypeVar("M")  # what comes with a sample of the IMU

SPEEDS_AGE = 0.1  # s; real time: measured speeds that differ by more from a sample are not of its time
DEPTH = 64  # samples that may be incomplete at a time; older ones are given up


class StampJoin:
    """Call ``callback(stamp_ns, *messages)`` with one message of each input, all of the same stamp.

    An input whose stamps go back has begun a new flight: what it left waiting of the old one is forgotten.
    """

    def __init__(self, inputs: Sequence[str], callback: Callable[..., None]) -> None:
        self._inputs = tuple(inputs)
        self._callback = callback
        self._waiting: dict[int, dict[str, object]] = {}
        self._newest = dict.fromkeys(self._inputs, -1)
        self.given_up = 0

    def put(self, name: str, stamp_ns: int, message: object) -> None:
        """Add a message [stamp in ns]; calls back if it completes its sample."""
        if stamp_ns <= self._newest[name]:
            for known in [known for known in self._waiting if known >= stamp_ns]:
                self._waiting[known].pop(name, None)
                if not self._waiting[known]:
                    del self._waiting[known]
        self._newest[name] = stamp_ns
        sample = self._waiting.setdefault(stamp_ns, {})
        sample[name] = message
        if len(sample) == len(self._inputs):
            del self._waiting[stamp_ns]
            self._callback(stamp_ns, *(sample[key] for key in self._inputs))
        elif len(self._waiting) > DEPTH:
            del self._waiting[min(self._waiting)]
            self.given_up += 1


NO_TORQUE = np.zeros(3)  # N m


class CommandGate(Generic[M]):
    """Call ``callback(stamp_ns, message, command)`` for IMU samples, with the command that acted before each.

    In real time that is the latest. In lock-step a sample waits for the command of the sample before; a stamp
    that is not later than the last begins a new flight. A command that is not finite is replaced by the one
    before, and ``count`` gets the reason, with the ``topic``. ``first`` acts before any; None: not known.
    """

    def __init__(
        self,
        mode: str,
        callback: Callable[[int, M, Any], None],
        count: Callable[[str], None],
        topic: str = "torque/command",
        first: Floats | None = NO_TORQUE,
    ) -> None:
        self._lockstep = mode == "lockstep"
        self._callback, self._count, self._topic = callback, count, topic
        self._first = first
        self._samples: deque[tuple[int, M]] = deque(maxlen=DEPTH)
        self._newest_ns = -1
        self._begin()

    def _begin(self) -> None:
        self._samples.clear()
        self._command, self._command_stamp_ns = self._first, -1
        self._awaited_ns: int | None = None  # stamp of the last sample passed on

    def put_sample(self, stamp_ns: int, message: M) -> None:
        """Add a sample [stamp in ns]."""
        if not self._lockstep:
            self._callback(stamp_ns, message, self._command)
            return
        if stamp_ns <= self._newest_ns:
            self._begin()
        self._newest_ns = stamp_ns
        self._samples.append((stamp_ns, message))
        self._release()

    def put_command(self, stamp_ns: int, command: Floats) -> None:
        """Add a command [stamp in ns]: a torque [N m] (3,), or rotor speeds [rad/s] (n,)."""
        if is_usable(command):
            self._command = command
        else:
            self._count(f"{self._topic}: not finite")
        self._command_stamp_ns = stamp_ns
        self._release()

    def _release(self) -> None:
        while self._samples and self._awaited_ns in (None, self._command_stamp_ns):
            self._awaited_ns, message = self._samples.popleft()
            self._callback(self._awaited_ns, message, self._command)


@dataclasses.dataclass(frozen=True)
class PlaceParameters:
    """When positions come."""

    period: float = parameter(0.01, unit="s", low=1e-4, high=10.0, doc="of the position sensor; in lock-step")
    delay: float = parameter(
        0.0, unit="s", low=0.0, high=1.0, doc="of a position behind the IMU; in lock-step"
    )


class PlaceGate(Generic[M]):
    """Call ``callback(stamp_ns, message, place)`` for IMU samples, with what the position sensor says then.

    ``place`` is None where nothing came. In real time it is what came last, once. In lock-step a sample waits
    for the position that belongs to it: every ``period`` [s] from the first sample on, ``delay`` [s] behind.
    """

    def __init__(
        self,
        mode: str,
        period: float,
        delay: float,
        callback: Callable[[int, M, PositionSample | None], None],
    ) -> None:
        self._lockstep = mode == "lockstep"
        self._period_ns, self._delay_ns = (round(each * 1e9) for each in (period, delay))
        self._callback = callback
        self._newest_ns = -1
        self._begin(0)

    def _begin(self, stamp_ns: int) -> None:
        self._first_ns = stamp_ns
        self._samples: deque[tuple[int, M]] = deque(maxlen=DEPTH)
        self._places: dict[int, PositionSample] = {}

    def put_sample(self, stamp_ns: int, message: M) -> None:
        """Add a sample of the IMU [stamp in ns]."""
        if not self._lockstep:
            newest = self._places.popitem()[1] if self._places else None
            self._places.clear()
            self._callback(stamp_ns, message, newest)
            return
        if stamp_ns <= self._newest_ns or self._newest_ns < 0:
            early = {known: place for known, place in self._places.items() if known >= stamp_ns}
            self._begin(stamp_ns)
            self._places = early
        self._newest_ns = stamp_ns
        self._samples.append((stamp_ns, message))
        self._release()

    def put_place(self, stamp_ns: int, place: PositionSample) -> None:
        """Add what the position sensor measured at a stamp [ns]."""
        self._places[stamp_ns] = place
        if self._lockstep:
            self._release()
        elif len(self._places) > DEPTH:
            del self._places[min(self._places)]

    def _release(self) -> None:
        while self._samples:
            stamp_ns, message = self._samples[0]
            measured_ns = stamp_ns - self._delay_ns
            elapsed_ns = measured_ns - self._first_ns
            due = elapsed_ns >= 0 and elapsed_ns % self._period_ns == 0
            if due and measured_ns not in self._places:
                return
            self._samples.popleft()
            place = self._places.get(measured_ns)
            self._places = {known: each for known, each in self._places.items() if known > measured_ns}
            self._callback(stamp_ns, message, place)


class SpeedGate(Generic[M]):
    """Call ``callback(stamp_ns, message, speeds)`` for IMU samples, with the rotor speeds measured with each.

    In real time these are the latest, None if they are older than `SPEEDS_AGE` or cannot be used. In
    lock-step a sample waits for those of its stamp.
    """

    def __init__(self, mode: str, callback: Callable[[int, M, Floats | None], None]) -> None:
        self._callback = callback
        self._join = StampJoin(("sample", "speeds"), callback) if mode == "lockstep" else None
        self._latest: tuple[int, Floats] | None = None

    def put_sample(self, stamp_ns: int, message: M) -> None:
        """Add a sample [stamp in ns]."""
        if self._join is not None:
            self._join.put("sample", stamp_ns, message)
            return
        latest = self._latest
        fresh = latest is not None and abs(seconds(stamp_ns - latest[0])) <= SPEEDS_AGE
        self._callback(stamp_ns, message, latest[1] if latest is not None and fresh else None)

    def put_speeds(self, stamp_ns: int, speeds: Floats) -> None:
        """Add speeds [rad/s] (n,) measured at a stamp [ns]."""
        usable = is_usable(speeds)
        if self._join is not None:
            self._join.put("speeds", stamp_ns, speeds if usable else None)
        elif usable:
            self._latest = stamp_ns, speeds
