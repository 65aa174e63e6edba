"""Joining messages by stamp: in lock-step a node waits until everything of one sample is there."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

DEPTH = 64  # samples that may be incomplete at a time; older ones are given up


class StampJoin:
    """Call back with one message of each input, all of the same stamp.

    Parameters
    ----------
    inputs : sequence of str
        Names of the inputs.
    callback : callable
        ``callback(stamp_ns, *messages)``, in the order of ``inputs``.
    """

    def __init__(self, inputs: Sequence[str], callback: Callable[..., None]) -> None:
        self._inputs = tuple(inputs)
        self._callback = callback
        self._waiting: dict[int, dict[str, Any]] = {}
        self.given_up = 0

    def put(self, name: str, stamp_ns: int, message: Any) -> None:
        """Add a message [stamp in ns]; calls back if it completes its sample."""
        sample = self._waiting.setdefault(stamp_ns, {})
        sample[name] = message
        if len(sample) == len(self._inputs):
            del self._waiting[stamp_ns]
            self._callback(stamp_ns, *(sample[key] for key in self._inputs))
        elif len(self._waiting) > DEPTH:
            del self._waiting[min(self._waiting)]
            self.given_up += 1

    def clear(self) -> None:
        """Forget what waits."""
        self._waiting.clear()


class TorqueGate:
    """Pairs each IMU sample with the torque that acted before it: the command of the sample before.

    Parameters
    ----------
    mode : str
        In ``lockstep`` a sample waits until that very command has come; in ``realtime`` the latest one is taken.
    callback : callable
        ``callback(stamp_ns, message, torque)``; the torque [N m] is an array (3,).
    initial : array (3,)
        Torque before the first command [N m].
    """

    def __init__(self, mode: str, callback: Callable[[int, Any, Any], None], initial: Any) -> None:
        self._lockstep = mode == "lockstep"
        self._callback = callback
        self._initial = initial
        self._samples: deque[tuple[int, Any]] = deque(maxlen=DEPTH)
        self.clear()

    def clear(self) -> None:
        """Start anew: the next sample is the first."""
        self._samples.clear()
        self._torque, self._torque_stamp_ns = self._initial, -1
        self._awaited_ns: int | None = None  # stamp of the last sample passed on

    def put_sample(self, stamp_ns: int, message: Any) -> None:
        """Add a sample [stamp in ns]."""
        if not self._lockstep:
            self._callback(stamp_ns, message, self._torque)
            return
        self._samples.append((stamp_ns, message))
        self._release()

    def put_torque(self, stamp_ns: int, torque: Any) -> None:
        """Add a command [stamp in ns]."""
        self._torque, self._torque_stamp_ns = torque, stamp_ns
        self._release()

    def _release(self) -> None:
        while self._samples and self._awaited_ns in (None, self._torque_stamp_ns):
            self._awaited_ns, message = self._samples.popleft()
            self._callback(self._awaited_ns, message, self._torque)
