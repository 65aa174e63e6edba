"""Lock-step: two runs give the same messages, and the graph is the closed loop without ROS, bit for bit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from quadftc_bench.bags import read_bag
from quadftc_bench.closed_loop import fly
from quadftc_bench.flight import Flight, flight_from_bag
from quadftc_bench.scenario import find_scenario, load_scenario, node_parameters, with_duration


def short(name, duration):
    return with_duration(load_scenario(find_scenario(name)), duration)


def messages_by_topic(directory):
    """Topic -> messages as bytes; the compute time, the last 8 bytes of control/status, left out.

    /diagnostics has many publishers, between which there is no order within a stamp: it is sorted.
    """
    found: dict[str, list[tuple[int, bytes]]] = {}
    for topic, log_time_ns, data in read_bag(directory).messages():
        cut = data[:-8] if topic == "/control/status" else data
        found.setdefault(topic, []).append((log_time_ns, bytes(cut)))
    found["/diagnostics"].sort()
    return found


def assert_equal_bit_for_bit(actual: Flight, expected: Flight):
    for field in dataclasses.fields(Flight):
        np.testing.assert_array_equal(
            getattr(actual, field.name), getattr(expected, field.name), err_msg=field.name
        )


@pytest.mark.parametrize("scheme", ["proposed", "conventional"])
def test_graph_equals_the_closed_loop_when_everything_happens_at_once(fly_graph, busy_scenario, scheme):
    directory, _ = fly_graph(busy_scenario, scheme)
    flight = flight_from_bag(read_bag(directory))
    assert not flight.delivered.all()  # samples were withheld
    assert np.nanmax(np.abs(flight.fault)) > 0.01  # and the fault was there
    assert_equal_bit_for_bit(flight, fly(node_parameters(busy_scenario, scheme)))


@pytest.mark.parametrize("scheme", ["proposed", "conventional"])
def test_graph_equals_the_closed_loop_on_the_paper_s_scenario(fly_graph, scheme):
    scenario = short("paper_constant_disturbance", 21.0)
    directory, _ = fly_graph(scenario, scheme)
    flight = flight_from_bag(read_bag(directory))
    assert np.degrees(flight.fault[-1, 0]) == pytest.approx(1.0)
    assert_equal_bit_for_bit(flight, fly(node_parameters(scenario, scheme)))


def test_two_runs_give_the_same_messages(fly_graph, busy_scenario):
    first, second = (messages_by_topic(fly_graph(busy_scenario, "proposed", take=take)[0]) for take in (0, 1))
    assert len(first["/imu/data"]) > 300
    assert first.keys() == second.keys()
    assert [topic for topic in first if first[topic] != second[topic]] == []


def test_processes_give_the_same_messages_as_one_process(fly_graph, busy_scenario):
    composed = messages_by_topic(fly_graph(busy_scenario, "proposed")[0])
    processes = messages_by_topic(fly_graph(busy_scenario, "proposed", graph="processes")[0])
    assert composed.keys() == processes.keys()
    assert [topic for topic in composed if composed[topic] != processes[topic]] == []
