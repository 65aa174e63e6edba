"""How often a node serves a sample and how old it is by then, for its diagnostics."""

from __future__ import annotations

from quadftc_ros.conversions import NANOSECONDS

WINDOW_NS = 900_000_000  # ns; shorter ones say little: diagnostics come at once on a change


class SampleTiming:
    """Rate and latency of the samples of the last second, or since the diagnostics before if that is longer.

    Latency is the age of a sample, by its stamp, when the node is done with it.

    Parameters
    ----------
    clock : bool
        Whether the samples come by a clock, that of `sampled` and `values`; otherwise rates count by the
        stamps, and there is no latency.
    """

    def __init__(self, clock: bool) -> None:
        self._clock = clock
        self._stamp_ns = -1  # newest
        self._begin_ns: int | None = None  # of the window
        self._count, self._sum_ns, self._worst_ns = 0, 0, 0
        self._values: dict[str, object] = {}
        self.idle = False  # whether no sample came in the window before

    @property
    def began(self) -> bool:
        """Whether there was a sample at all."""
        return self._begin_ns is not None

    def sampled(self, stamp_ns: int, now_ns: int = 0) -> None:
        """Note that the sample of a stamp was served [ns]; one that was noted before does not count."""
        if stamp_ns == self._stamp_ns:
            return
        if self._begin_ns is None or (not self._clock and stamp_ns < self._stamp_ns):  # or a new flight
            self._begin(now_ns if self._clock else stamp_ns)
            self._stamp_ns = stamp_ns
            return
        self._stamp_ns = stamp_ns
        self._count += 1
        age_ns = now_ns - stamp_ns
        self._sum_ns += age_ns
        self._worst_ns = max(self._worst_ns, age_ns)

    def values(self, now_ns: int = 0) -> dict[str, object]:
        """Return ``rate_hz``, ``latency_ms`` and ``latency_max_ms`` of the last window, as text."""
        if self._begin_ns is None:
            return {}
        end_ns = now_ns if self._clock else self._stamp_ns
        if not 0 <= end_ns - self._begin_ns < WINDOW_NS:
            self._close(end_ns)
        return self._values

    def _close(self, end_ns: int) -> None:
        assert self._begin_ns is not None
        passed_ns = end_ns - self._begin_ns
        self.idle = self._count == 0
        self._values = {}
        if passed_ns > 0:  # else the clock was set back
            self._values["rate_hz"] = f"{self._count * NANOSECONDS / passed_ns:.1f}"
            if self._clock and self._count:
                self._values["latency_ms"] = f"{self._sum_ns / self._count * 1e-6:.2f}"
                self._values["latency_max_ms"] = f"{self._worst_ns * 1e-6:.2f}"
        self._begin(end_ns)

    def _begin(self, begin_ns: int) -> None:
        self._begin_ns = begin_ns
        self._count, self._sum_ns, self._worst_ns = 0, 0, 0
