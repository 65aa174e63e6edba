"""Joining by stamp: what belongs together is found in any order of arrival, also when a new flight begins."""

import itertools
import math

import numpy as np
import pytest

from quadftc_ros.join import DEPTH, CommandGate, StampJoin


@pytest.fixture
def joined():
    return []


@pytest.fixture
def join(joined):
    return StampJoin(("a", "b", "c"), lambda *arguments: joined.append(arguments))


@pytest.mark.parametrize("order", list(itertools.permutations("abc")))
def test_messages_of_one_stamp_come_together_in_any_order_of_arrival(join, joined, order):
    for stamp in (1, 2):
        for name in order:
            join.put(name, stamp, f"{name}{stamp}")
    assert joined == [(1, "a1", "b1", "c1"), (2, "a2", "b2", "c2")]


def test_inputs_may_be_ahead_of_each_other(join, joined):
    for name, stamps in (("a", (1, 2, 3)), ("b", (1, 2)), ("c", (1,))):
        for stamp in stamps:
            join.put(name, stamp, f"{name}{stamp}")
    assert [arguments[0] for arguments in joined] == [1]
    join.put("c", 2, "c2")
    assert joined[-1] == (2, "a2", "b2", "c2")


def test_sample_that_never_becomes_complete_is_given_up(join, joined):
    for stamp in range(DEPTH + 1):
        join.put("a", stamp, stamp)
    assert join.given_up == 1
    join.put("b", 0, 0)  # too late for the oldest
    join.put("c", 0, 0)
    join.put("b", 1, 1)
    join.put("c", 1, 1)
    assert [arguments[0] for arguments in joined] == [1]


@pytest.mark.parametrize("order", list(itertools.permutations("abc")))
def test_new_flight_forgets_what_waits_of_the_old_one(join, joined, order):
    join.put("c", 1, "old")
    for stamp in (1, 2, 3):
        join.put("a", stamp, "old")
        join.put("b", stamp, "old")
    for stamp in (1, 2, 3):
        for name in order:
            join.put(name, stamp, "new")
    assert joined == [(1, "old", "old", "old"), *((stamp, "new", "new", "new") for stamp in (1, 2, 3))]


@pytest.fixture
def passed():
    return []


def gate_of(mode, passed, count=str):
    def pass_on(stamp, message, torque):
        passed.append((stamp, message, torque.tolist()))

    return CommandGate(mode, pass_on, count)


def torque(size):
    return np.full(3, float(size))


def test_lockstep_pairs_each_sample_with_the_command_of_the_one_before(passed):
    gate = gate_of("lockstep", passed)
    gate.put_sample(1, "s1")
    gate.put_sample(2, "s2")  # early: its torque has not come yet
    assert passed == [(1, "s1", [0.0] * 3)]
    gate.put_command(1, torque(10))
    gate.put_command(2, torque(20))  # the next time the torque is early
    gate.put_sample(3, "s3")
    assert passed[1:] == [(2, "s2", [10.0] * 3), (3, "s3", [20.0] * 3)]


def test_lockstep_ignores_the_command_of_another_sample(passed):
    gate = gate_of("lockstep", passed)
    gate.put_sample(1, "s1")
    gate.put_sample(2, "s2")
    gate.put_command(7, torque(70))
    assert [stamp for stamp, *_ in passed] == [1]


def test_lockstep_begins_anew_when_stamps_go_back(passed):
    gate = gate_of("lockstep", passed)
    gate.put_sample(5, "old")
    gate.put_sample(6, "waits for ever")
    gate.put_sample(5, "new")
    assert passed == [(5, "old", [0.0] * 3), (5, "new", [0.0] * 3)]


def test_real_time_takes_the_latest_command(passed):
    gate = gate_of("realtime", passed)
    gate.put_sample(1, "s1")
    gate.put_command(1, torque(10))
    gate.put_command(2, torque(20))
    gate.put_sample(9, "s9")
    assert passed == [(1, "s1", [0.0] * 3), (9, "s9", [20.0] * 3)]


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_command_that_is_no_number_is_replaced_by_the_one_before(passed, mode, bad):
    counted = []
    gate = gate_of(mode, passed, counted.append)
    gate.put_sample(1, "s1")
    gate.put_command(1, torque(10))
    gate.put_sample(2, "s2")
    assert not counted
    gate.put_command(2, np.array([1.0, bad, 1.0]))
    assert counted == ["torque/command: not finite"]
    gate.put_sample(3, "s3")
    assert [row[2] for row in passed] == [[0.0] * 3, [10.0] * 3, [10.0] * 3]
