"""The order of a lock-step recording: by log time and channel, whatever order the messages arrived in."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections import deque
from operator import itemgetter

CUT_PERIOD_NS = 100_000_000  # ns of log time between two cuts
CUT_DELAY_NS = 200_000_000  # ns of log time that a message may come late without losing its place
HOLD_PERIOD = 0.75  # s, wall time that a message may be held (0.4 of real time) before order gives way

Message = tuple[int, int, int, bytes]  # channel, log time [ns], publish time [ns], data


class HeldMessages:
    """Messages of a lock-step recording whose place in the file is not certain yet."""

    def __init__(self) -> None:
        self._messages: list[Message] = []
        self._cut_ns: int | None = None  # log time of the last cut
        self._newest_ns = 0
        self._arrivals: deque[tuple[int, float]] = deque()  # log time not reached before [ns], wall time [s]
        self._reached_ns = 0  # the last of them

    def add(self, message: Message) -> bool:
        """Add a message; return whether log time has moved on far enough to cut a chunk."""
        log_time_ns = message[1]
        if not self._arrivals or log_time_ns > self._reached_ns:
            self._arrivals.append((log_time_ns, time.monotonic()))
            self._reached_ns = log_time_ns
        self._messages.append(message)
        if self._cut_ns is None:
            self._cut_ns = log_time_ns - log_time_ns % CUT_PERIOD_NS
        self._newest_ns = max(self._newest_ns, log_time_ns)
        return self._newest_ns - CUT_DELAY_NS >= self._cut_ns + CUT_PERIOD_NS

    def take(self) -> list[Message]:
        """Take the messages before the newest cut, in the order (log time, channel)."""
        self._cut_ns = (self._newest_ns - CUT_DELAY_NS) // CUT_PERIOD_NS * CUT_PERIOD_NS
        messages = self._sorted()
        split = bisect_left(messages, self._cut_ns, key=itemgetter(1))
        self._messages = messages[split:]
        while self._arrivals and self._arrivals[0][0] < self._cut_ns:
            self._arrivals.popleft()
        return messages[:split]

    def take_all(self) -> list[Message]:
        """Take all messages, in the order (log time, channel)."""
        messages = self._sorted()
        self._messages = []
        self._arrivals.clear()
        return messages

    def is_stale(self) -> bool:
        """Return whether a message has been held for so long that a killed process would lose too much."""
        return bool(self._arrivals) and time.monotonic() - self._arrivals[0][1] > HOLD_PERIOD

    def _sorted(self) -> list[Message]:
        return sorted(self._messages, key=itemgetter(1, 0))
