"""Streams of two publishers are told apart: the first is followed, and what replaces it once it is gone."""

import heapq

import pytest

from quadftc_ros.streams import UNKNOWN, Mark, Streams

MS = 1_000_000  # ns
LEAD, OTHER = "a", "b"


class Wire:
    """A topic at whose end are streams; publishers come, go and send."""

    def __init__(self):
        self.publishers = {}
        self.streams = Streams(lambda: dict(self.publishers))

    def send(self, *senders):
        """Have senders send in turn; return who was followed, message by message."""
        due = heapq.merge(*(sender(gid) for gid, sender in senders))
        return [gid for now, gid, mark in due if self.streams.follows(mark, now)]


def sender(first_ns=0, count=1000, number=1, period=4 * MS, stamp=lambda now: now, jitter=lambda k: 0):
    """Make what sends so many messages [ns]."""

    def send(gid):
        for k in range(count):
            now = first_ns + k * period
            yield now + jitter(k), gid, Mark(number + k, now + jitter(k), stamp(now))

    return send


def busy(k):
    """How late a publisher is on a busy machine [ns]."""
    return (k * 7919) % 100 * MS // 40


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(sender(2000 * MS, 500), id="late"),
        pytest.param(sender(2 * MS, 900, number=1, jitter=busy), id="with_equal_numbers"),
        pytest.param(sender(1000 * MS, 20_000, period=MS // 10), id="flood_that_overtakes"),
        pytest.param(sender(2000 * MS, 500, stamp=lambda now: now + 1000_000 * MS), id="from_the_future"),
        pytest.param(sender(2000 * MS, 500, number=100_000), id="that_counts_ahead"),
    ],
)
def test_first_stream_is_followed_whatever_comes_beside_it(other):
    wire = Wire()
    wire.publishers = {LEAD: "/driver"}
    lead = sender(0, 10, jitter=busy)
    assert wire.send((LEAD, lead)) == [LEAD] * 10
    wire.publishers[OTHER] = "/intruder"
    wire.streams.see(wire.publishers)
    lead = sender(40 * MS, 1000, number=11, jitter=busy)
    followed = wire.send((LEAD, lead), (OTHER, other))
    assert followed.count(LEAD) >= 990
    assert followed.count(OTHER) <= 10
    assert followed[-100:] == [LEAD] * 100
    assert wire.streams.strangers() == [OTHER]


def test_restarted_publisher_takes_over_at_once_when_the_graph_says_that_the_old_is_gone():
    wire = Wire()
    wire.publishers = {LEAD: "/driver"}
    wire.send((LEAD, sender(0, 500)))
    wire.publishers[OTHER] = "/other"
    assert wire.send((OTHER, sender(2001 * MS, 20))) == []
    del wire.publishers[LEAD]
    assert len(wire.send((OTHER, sender(2081 * MS, 20, number=21)))) >= 18
    assert wire.streams.strangers() == []


@pytest.mark.parametrize(("name", "taken"), [("/driver", True), ("/intruder", False), (UNKNOWN, False)])
def test_silent_publisher_that_the_graph_still_has_is_replaced_by_one_of_its_name_only(name, taken):
    wire = Wire()
    wire.publishers = {LEAD: "/driver"}
    wire.send((LEAD, sender(0, 500)))
    wire.publishers[OTHER] = name
    followed = wire.send((OTHER, sender(2100 * MS, 100)))
    assert (len(followed) > 90) == bool(followed) == taken
    assert wire.streams.strangers() == ([] if taken else [OTHER])


def test_publisher_that_never_speaks_costs_no_message():
    wire = Wire()
    wire.publishers = {LEAD: "/driver", OTHER: "/panel"}
    assert len(wire.send((LEAD, sender(0, 1000, jitter=busy)))) >= 999


def test_only_publisher_is_followed_on_when_its_numbers_begin_anew():
    wire = Wire()
    wire.publishers = {LEAD: "/driver"}
    assert wire.send((LEAD, sender(0, 100))) == [LEAD] * 100
    again = sender(1000 * MS, 100, stamp=lambda now: now - 1000 * MS)
    assert wire.send((LEAD, again)) == [LEAD] * 100
    assert wire.streams.followed.count == 100


def test_messages_that_are_lost_do_not_end_a_stream():
    wire = Wire()
    wire.publishers = {LEAD: "/driver"}
    wire.send((LEAD, sender(0, 100)))
    assert len(wire.send((LEAD, sender(5000 * MS, 100, number=1250)))) == 100
