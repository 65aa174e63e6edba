"""Which message of a topic is whose: the stream that came first is followed, others are dropped.

rclpy says of a message neither its publisher nor a GID; it gives the number by which the publisher counts
it, and the time of sending. A stream is what continues both, and the stamps. Two publishers that were started
together count alike: then times and stamps decide. The graph says which publishers there are.

A stream is given up for another

* when its publisher is no longer in the graph,
* when it is silent and the other comes from a node of the same name: a restart. A process that was killed
  stays in the graph for 20 s, the lease of its participant.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from itertools import pairwise
from statistics import median
from typing import NamedTuple

UNKNOWN = "_NODE_NAME_UNKNOWN_"  # what the graph calls a node whose name it does not know (yet), or has none
MEMORY = 32  # messages from which the period of a stream is known
KNOWN = 3  # messages of a stream after which it is worth a name
BURST = 50.0  # periods; by so much a publisher that was held up may be ahead of its period
TIGHT = 0.3  # periods; more off its times, a message may be of a publisher that was not heard yet
SILENT_NS = 100_000_000  # ns; a stream that is silent for so long, and for `GAP` periods, may be dead
GAP = 3.0
LOOK_NS = 2_000_000  # ns; not more often the graph is asked, which takes 60 us
MOST = 4  # streams that are kept beside the one that is followed

Publishers = Mapping[str, str]  # GID of a publisher -> full name of its node, or `UNKNOWN`


class Mark(NamedTuple):
    """What tells a message's stream."""

    number: int  # by which its publisher counts its messages
    sent_ns: int  # by the publisher's clock
    stamp_ns: int  # of the header


class Stream:
    """What one publisher sends on a topic."""

    def __init__(self) -> None:
        self.gid = ""  # of its publisher; empty: not known
        self.heard_ns = 0  # when the last message came, by the monotonic clock
        self._marks: deque[Mark] = deque(maxlen=MEMORY)
        self._periods: tuple[float, float] | None = None  # of sending and of stamps [ns]
        self.count = 0

    @property
    def last(self) -> Mark:
        """The last message."""
        return self._marks[-1]

    def add(self, mark: Mark, now_ns: int) -> None:
        """Note a message."""
        self._marks.append(mark)
        self.heard_ns = now_ns
        self.count += 1
        if self.count % MEMORY == KNOWN:
            self._periods = None

    def begin(self, mark: Mark, now_ns: int) -> None:
        """Note a message, and forget those before."""
        self._marks.clear()
        self._periods, self.count = None, 0
        self.add(mark, now_ns)

    @property
    def established(self) -> bool:
        """Whether its periods are known."""
        return len(self._marks) >= KNOWN

    def misfits(self, mark: Mark, like: Stream) -> tuple[float, float]:
        """Return by how many periods a message is off the times of sending and the stamps of this stream.

        Infinite: it is of another. As long as its periods are not known, they are those ``like`` another's.
        """
        last = self._marks[-1]
        steps = mark.number - last.number
        source = self if self.established else like
        if steps <= 0:
            return math.inf, math.inf
        if not source.established:
            return float(steps - 1), float(steps - 1)
        period, stamp_period = source._find_periods()
        passed = (mark.sent_ns - last.sent_ns) / period
        if steps - passed > BURST:  # nobody sends so many in this time
            return math.inf, math.inf
        return abs(passed - steps), abs((mark.stamp_ns - last.stamp_ns) / stamp_period - steps)

    def is_silent(self, now_ns: int, least_ns: int = SILENT_NS) -> bool:
        """Whether nothing has come for longer than a gap, and a least time."""
        period = self._find_periods()[0] if self.established else 0.0
        return now_ns - self.heard_ns > max(least_ns, GAP * period)

    def _find_periods(self) -> tuple[float, float]:
        """Return the median periods of sending and of stamps [ns], at least 1."""
        if self._periods is None:
            marks = list(self._marks)
            pairs = [(b.number - a.number, a, b) for a, b in pairwise(marks)]
            sent = median((b.sent_ns - a.sent_ns) / steps for steps, a, b in pairs)
            stamps = median((b.stamp_ns - a.stamp_ns) / steps for steps, a, b in pairs)
            self._periods = max(1.0, sent), max(1.0, stamps)
        return self._periods


class Streams:
    """Follows one stream of a topic; ``look()`` returns the publishers that the graph has now.

    ``own`` is the full name of a node that publishes the topic, if that watches it itself.
    """

    def __init__(self, look: Callable[[], Publishers], own: str = "") -> None:
        self._look, self._own = look, own
        self._looked_ns = -LOOK_NS
        self.publishers: Publishers = {}
        self.followed: Stream | None = None
        self._others: list[Stream] = []
        self._name = ""  # of the node that was followed last
        self._replaced = set[str]()  # GIDs of publishers that fell silent, and restarted under another GID

    def see(self, publishers: Publishers) -> None:
        """Note the publishers that the graph has: streams whose publisher is gone end."""
        first = {gid: publishers[gid] for gid in self.publishers if gid in publishers}
        self.publishers = publishers = {**first, **publishers}  # those that came first, first
        self._replaced &= publishers.keys()
        self._others = [each for each in self._others if not each.gid or each.gid in publishers]
        lead = self.followed
        if lead is None:
            return
        if lead.gid and lead.gid not in publishers:
            self.followed = None
        elif len(publishers) == 1:
            if not lead.gid:  # who has gone is not known: the one that still speaks is there
                self.followed = lead = max((lead, *self._others), key=lambda each: each.heard_ns)
            lead.gid = next(iter(publishers))
            self._others.clear()
        self._name = self._name_of(self.followed) or self._name

    def follows(self, mark: Mark, now_ns: int) -> bool:
        """Whether a message is of the stream that is followed [monotonic time in ns]."""
        lead = self.followed
        alone = not self._others and len(self.publishers) < 2
        if lead is not None and lead.gid and alone and mark.number - lead.last.number == 1:
            lead.add(mark, now_ns)
            return True
        due = now_ns - self._looked_ns >= LOOK_NS
        if due and (lead is None or alone or lead.is_silent(now_ns, 0)):
            self._looked_ns = now_ns
            self.see(self._look())
            lead = self.followed
        if lead is not None and len(self.publishers) == 1:  # messages were lost, or it counts anew
            lost = math.isfinite(lead.misfits(mark, lead)[0])
            (lead.add if lost else lead.begin)(mark, now_ns)
            return True
        stream = self._stream_of(mark)
        stream.add(mark, now_ns)
        self._identify(stream)
        if lead is None:
            name = self._name_of(stream)
            if self._name not in self.publishers.values() or name in ("", self._name):
                self._follow(stream)
        elif stream is not lead and lead.is_silent(now_ns) and self._is_restart(lead, stream):
            self._replaced.add(lead.gid)
            self._follow(stream)
        return stream is self.followed

    def strangers(self) -> list[str]:
        """Return the GIDs of publishers beside the first, without those that have restarted."""
        lead = self.followed.gid if self.followed is not None else ""
        own = [gid for gid, name in self.publishers.items() if name == self._own]
        first = own or [lead or next(iter(self.publishers), "")]
        return [gid for gid in self.publishers if gid not in first and gid not in self._replaced]

    def _stream_of(self, mark: Mark) -> Stream:
        """Return the stream that a message continues best, or a new one.

        Mostly the number alone tells. Where it continues several streams, times and stamps do.
        """
        lead, streams = self.followed, [*self._others]
        if lead is not None:
            streams.insert(0, lead)
            misfits = lead.misfits(mark, lead)
            others = [each for each in self._others if each.established]
            unheard = len(streams) < len(self.publishers)
            rivals = (sum(each.misfits(mark, lead)) for each in others)
            if math.isfinite(misfits[0]) and sum(misfits) <= min(rivals, default=math.inf):
                if not unheard or min(misfits) <= TIGHT:
                    return lead
                streams.clear()  # of somebody who was not heard yet
        fits = [(sum(each.misfits(mark, lead or each)), k) for k, each in enumerate(streams)]
        best, k = min(fits, default=(math.inf, 0))
        if math.isfinite(best):
            return streams[k]
        new = Stream()
        self._others = [*sorted(self._others, key=lambda each: each.heard_ns)[1 - MOST :], new]
        return new

    def _identify(self, stream: Stream) -> None:
        """Find the publisher of a stream: the only one whose stream is not known."""
        if stream.gid or (len(self.publishers) > 1 and not stream.established):
            return
        known = {each.gid for each in (self.followed, *self._others) if each is not None}
        free = [gid for gid in self.publishers if gid not in known and gid not in self._replaced]
        if len(free) == 1:
            stream.gid = free[0]

    def _follow(self, stream: Stream) -> None:
        self._others = [each for each in self._others if each is not stream]
        self.followed = stream
        self._name = self._name_of(stream) or self._name

    def _is_restart(self, lead: Stream, stream: Stream) -> bool:
        name = self._name_of(stream)
        return bool(name) and name == self._name_of(lead)

    def _name_of(self, stream: Stream | None) -> str:
        name = self.publishers.get(stream.gid, "") if stream is not None else ""
        return "" if name == UNKNOWN else name
