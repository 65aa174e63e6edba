"""Joining messages by stamp: in lock-step a node waits until everything of one sample is there."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from quadftc_model.samples import is_usable
from quadftc_ros.conversions import Floats

DEPTH = 64  # samples that may be incomplete at a time; older ones are given up


class StampJoin:
    """Call ``callback(stamp_ns, *messages)`` with one message of each input, all of the same stamp.

    An input whose stamps go back has begun a new flight: what it left waiting of the old one is forgotten.
    """

    def __init__(self, inputs: Sequence[str], callback: Callable[..., None]) -> None:
        self._inputs = tuple(inputs)
        self._callback = callback
        self._waiting: dict[int, dict[str, Any]] = {}
        self._newest = dict.fromkeys(self._inputs, -1)
        self.given_up = 0

    def put(self, name: str, stamp_ns: int, message: Any) -> None:
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


class TorqueGate:
    """Call ``callback(stamp_ns, message, torque)`` for IMU samples, with the torque that acted before each.

    In real time that is the latest. In lock-step a sample waits for the command of the sample before; a stamp
    that is not later than the last begins a new flight. A torque that is not finite is replaced by the one
    before, and ``count`` gets the reason.
    """

    def __init__(
        self, mode: str, callback: Callable[[int, Any, Floats], None], count: Callable[[str], None]
    ) -> None:
        self._lockstep = mode == "lockstep"
        self._callback, self._count = callback, count
        self._samples: deque[tuple[int, Any]] = deque(maxlen=DEPTH)
        self._newest_ns = -1
        self._begin()

    def _begin(self) -> None:
        self._samples.clear()
        self._torque, self._torque_stamp_ns = np.zeros(3), -1
        self._awaited_ns: int | None = None  # stamp of the last sample passed on

    def put_sample(self, stamp_ns: int, message: Any) -> None:
        """Add a sample [stamp in ns]."""
        if not self._lockstep:
            self._callback(stamp_ns, message, self._torque)
            return
        if stamp_ns <= self._newest_ns:
            self._begin()
        self._newest_ns = stamp_ns
        self._samples.append((stamp_ns, message))
        self._release()

    def put_torque(self, stamp_ns: int, torque: Floats) -> None:
        """Add a command [stamp in ns, N m (3,)]."""
        if is_usable(torque):
            self._torque = torque
        else:
            self._count("torque/command: not finite")
        self._torque_stamp_ns = stamp_ns
        self._release()

    def _release(self) -> None:
        while self._samples and self._awaited_ns in (None, self._torque_stamp_ns):
            self._awaited_ns, message = self._samples.popleft()
            self._callback(self._awaited_ns, message, self._torque)
