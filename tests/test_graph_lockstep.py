"""Lock-step: two runs give the same messages, and the graph is the closed loop without ROS, bit for bit."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from accusing_observer import registered
from std_srvs.srv import Trigger

from bag_messages import messages_by_topic
from node_bench import NodeBench
from quadftc_bags.bag import read_bag
from quadftc_control.controller import controllers
from quadftc_control.controllers.ismc import Ismc
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.disturbance_observers.exosystem import Exosystem
from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.fault_observers.sliding_mode import SlidingMode
from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import NO_STATE, Flight, flight_from_bag
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.scenario import find_scenario, load_scenario, node_parameters, with_duration
from quadftc_model.arrays import where
from quadftc_model.samples import FAULTY, HEALTHY, RECOVERING

SCENARIOS = Path(__file__).parent / "scenarios"
# the step, the disturbance and the faults of a paper's scenario within the first seconds
SOONER = (
    "references.0.start=0.2 s",
    "references.0.stop=2.5 s",
    "disturbances.0.start=0.5 s",
    *(f"faults.{number}.start=2 s" for number in range(3)),
)


def assert_equal_bit_for_bit(actual: Flight, expected: Flight):
    for field in dataclasses.fields(Flight):
        np.testing.assert_array_equal(
            getattr(actual, field.name), getattr(expected, field.name), err_msg=field.name
        )


def test_graph_equals_the_closed_loop_when_everything_happens_at_once(fly_graph, busy_scenario):
    directory, _ = fly_graph(busy_scenario, "proposed")
    flight = flight_from_bag(read_bag(directory))
    assert not flight.delivered.all()  # samples were withheld
    assert np.nanmax(np.abs(flight.fault)) > 0.01  # and the fault was there
    assert_equal_bit_for_bit(flight, fly(busy_scenario, "proposed"))


def test_the_reference_flies_the_same_to_rounding_and_in_the_graph_bit_for_bit(fly_graph, busy_scenario):
    scenario = with_duration(busy_scenario, 0.9)  # it takes long
    directory, _ = fly_graph(scenario, "proposed", engine="numpy")
    flight, of_c = flight_from_bag(read_bag(directory)), fly(scenario, "proposed")
    assert_equal_bit_for_bit(flight, fly(scenario, "proposed", engine="numpy"))
    assert not np.array_equal(flight.angles, of_c.angles)  # that was compiled
    for name in ("angles", "body_rate", "fault_estimate", "torque"):
        expected = getattr(of_c, name)
        np.testing.assert_allclose(getattr(flight, name), expected, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.thorough
def test_a_long_free_flight_equals_the_closed_loop(fly_graph):
    scenario = with_duration(load_scenario(find_scenario("free_circle")), 16.0)  # with the first fault
    directory, _ = fly_graph(scenario, "isolating")
    flight = fly(scenario, "isolating")
    assert_equal_bit_for_bit(flight_from_bag(read_bag(directory)), flight)
    numpy = fly(scenario, "isolating", engine="numpy")
    np.testing.assert_allclose(flight.position, numpy.position, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("scheme", ["proposed", pytest.param("conventional", marks=pytest.mark.thorough)])
def test_graph_equals_the_closed_loop_on_the_paper_s_scenario(fly_graph, scheme):
    scenario = with_duration(load_scenario(find_scenario("paper_constant_disturbance"), SOONER), 3.5)
    directory, _ = fly_graph(scenario, scheme)
    flight = flight_from_bag(read_bag(directory))
    assert len(flight) == 875
    assert np.degrees(flight.fault[-1, 0]) == pytest.approx(1.0)
    assert np.all(np.max(np.abs(flight.angles), axis=0) > np.radians(3.0))  # it went somewhere
    assert_equal_bit_for_bit(flight, fly(scenario, scheme))


class RunawayObserver(SlidingMode):
    """Its estimate, and then its body rate, grow beyond all bounds until it restarts."""

    def init(self, inputs):
        return super().init(inputs), np.float64(1.0)

    def step(self, state, inputs, dt):
        law_state, growth = state
        law_state, estimate = super().step(law_state, inputs, dt)
        corrected, fault = estimate.corrected, estimate.fault
        fast = corrected._replace(body_rate=corrected.body_rate + 1e-4 * (growth - 1.0))
        return (law_state, 1.2 * growth), estimate._replace(
            fault=fault + 1e-3 * (growth - 1.0), corrected=fast
        )


class RunawayDisturbanceObserver(Exosystem):
    """Its estimate grows from 1 to beyond 1e6 rad/s², and is NaN now and then, until it restarts."""

    def init(self, inputs):
        return super().init(inputs), np.float64(1.0)

    def step(self, state, inputs, dt):
        law_state, growth = state
        law_state, estimate = super().step(law_state, inputs, dt)
        return (law_state, 1.3 * growth), estimate + where(inputs.rate_valid, growth, np.nan)


class RunawayController(Ismc):
    """Its sliding variable grows beyond all bounds until it restarts."""

    def init(self, inputs):
        return super().init(inputs), np.float64(1.0)

    def step(self, state, inputs, dt):
        law_state, growth = state
        law_state, output = super().step(law_state, inputs, dt)
        return (law_state, 1.3 * growth), output._replace(sliding_variable=output.sliding_variable * growth)


def test_graph_equals_the_closed_loop_when_laws_give_what_cannot_be_used(fly_graph, monkeypatch):
    runaways = {
        fault_observers: RunawayObserver,
        disturbance_observers: RunawayDisturbanceObserver,
        controllers: RunawayController,
    }
    for registry, law in runaways.items():
        registry.names()  # finds the others first
        monkeypatch.setitem(registry._components, "runaway", law)
    runaway = [f"schemes.proposed.{role}=runaway" for role in ("observer", "disturbance_observer")]
    scenario = load_scenario(SCENARIOS / "busy.yaml", [*runaway, "schemes.proposed.controller=runaway"])
    directory, _ = fly_graph(with_duration(scenario, 1.9), "proposed")
    flight = flight_from_bag(read_bag(directory))
    for column in (flight.fault_estimate, flight.disturbance_estimate, flight.sliding_variable):
        sizes = np.max(np.abs(column[flight.delivered]), axis=1)
        assert 1e4 < np.max(sizes) < 1e6  # it ran away, and was stopped:
        assert np.any((sizes[:-1] > 1e4) & (sizes[1:] == 0.0))
    assert_equal_bit_for_bit(flight, fly(with_duration(scenario, 1.9), "proposed"))


def test_graph_equals_the_closed_loop_in_what_is_said_of_each_sensor(fly_graph):
    """With an attitude that wanders."""
    with registered() as name:
        changes = [f"name={name}", f"schemes.conventional.observer={name}", "sensors={grade: ahrs, delay: 2}"]
        scenario = load_scenario(SCENARIOS / "busy.yaml", changes)
        directory, _ = fly_graph(scenario, "conventional")
        bag = read_bag(directory)
        flight, expected = flight_from_bag(bag), fly(scenario, "conventional")
    assert_equal_bit_for_bit(flight, expected)
    for state in (flight.gyro_state, flight.accelerometer_state):
        assert {HEALTHY, FAULTY, RECOVERING, NO_STATE} == set(np.unique(state))  # NO_STATE: samples withheld
    assert flight.gyro_ambiguous.any()
    assert flight.attitude_ambiguous.any()
    assert np.any(flight.gyro_onset_ns > 0)


def test_graph_equals_the_closed_loop_when_a_gyro_jumps(fly_graph):
    gyro = "{kind: bias, channel: gyro, axes: x, value: 0.3, start: 1.5 s}"
    changes = ["name=jump", "schemes.conventional.observer=isolating", f"faults=[{gyro}]"]
    scenario = load_scenario(SCENARIOS / "busy.yaml", changes)
    flight = flight_from_bag(read_bag(fly_graph(scenario, "conventional")[0]))
    assert_equal_bit_for_bit(flight, fly(scenario, "conventional"))
    assert flight.gyro_state[-1].tolist() == [FAULTY, HEALTHY, HEALTHY]


FREE_FAULTS = (
    "{kind: bias, axes: roll, value: 5 deg, start: 2.4 s}",
    "{kind: bias, channel: gyro, axes: x, value: 0.3, start: 2.7 s}",
    "{kind: dropout, channel: imu, probability: 0.05, start: 2.2 s}",
    "{kind: loss, rotors: [2], value: 0.2, rise: 0.1 s, start: 1.8 s}",
    "{kind: chipped, rotors: [3], unbalance: 1e-6, start: 2.5 s}",
    "{kind: stuck, channel: rotor, rotors: [1], start: 2.8 s, stop: 2.9 s}",
)


SOON = ("trajectories.0.start=0.2 s", "trajectories.0.rise=1 s")


def test_graph_equals_the_closed_loop_in_free_flight(fly_graph):
    changes = (*SOON, f"faults=[{', '.join(FREE_FAULTS)}]")
    scenario = load_scenario(find_scenario("free_circle"), changes)
    scenario = with_duration(scenario, 3.0)
    directory, _ = fly_graph(scenario, "isolating")
    flight = flight_from_bag(read_bag(directory))
    assert not flight.delivered.all()
    assert np.nanmax(np.abs(flight.position[:, 1])) > 0.5  # it flies
    assert np.nanmin(flight.rotor_effectiveness, axis=0) == pytest.approx([1.0, 0.8, 1.0, 1.0])
    assert FAULTY in flight.rotor_state[:, 1]  # named, and counted on
    assert_equal_bit_for_bit(flight, fly(scenario, "isolating"))


def test_graph_equals_the_closed_loop_where_rotors_are_measured_and_accused(fly_graph):
    changes = ["schemes.conventional.controller=indi", *SOON]
    changes.append("faults=[{kind: loss, rotors: [2], value: 0.25, start: 1 s}]")
    with registered() as name:
        changes += [f"name=rotors_{name}", f"schemes.conventional.observer={name}"]
        scenario = with_duration(load_scenario(find_scenario("free_circle"), changes), 2.0)
        flight = flight_from_bag(read_bag(fly_graph(scenario, "conventional")[0]))
        assert_equal_bit_for_bit(flight, fly(scenario, "conventional"))
        assert flight.rotor_ambiguous.any()
        assert np.any(flight.rotor_onset_ns > 0)
        assert flight.rotor_state[-1].tolist() == [HEALTHY, FAULTY, HEALTHY, HEALTHY]
        unmeasured = "schemes.conventional.controller={kind: indi, measured_torque: false}"
        other = with_duration(load_scenario(find_scenario("free_circle"), [*changes, unmeasured]), 2.0)
        assert np.any(flight.torque != fly(other, "conventional").torque)


def test_two_runs_give_the_same_messages(tmp_path, fly_graph, busy_scenario):
    scenario = with_duration(busy_scenario, 0.9)
    with ComposedGraph(GraphPlan(node_parameters(scenario), bag=tmp_path / "bag")) as graph:
        graph.run()
    first, second = messages_by_topic(fly_graph(scenario, "proposed")[0]), messages_by_topic(tmp_path / "bag")
    assert len(first["/imu/data"]) > 150
    assert first.keys() == second.keys()
    assert [topic for topic in first if first[topic] != second[topic]] == []


def test_two_vehicles_fly_in_one_process_without_hearing_each_other(tmp_path, busy_scenario):
    scenario = with_duration(busy_scenario, 1.0)
    plans = [
        GraphPlan(node_parameters(scenario, scheme), "lockstep", scheme, tmp_path / scheme)
        for scheme in ("proposed", "conventional")
    ]
    with ComposedGraph(*plans) as graph:
        graph.run()
    for scheme in ("proposed", "conventional"):
        flight = flight_from_bag(read_bag(tmp_path / scheme))
        assert_equal_bit_for_bit(flight, fly(scenario, scheme))


def test_two_vehicles_in_one_namespace_are_refused(busy_scenario):
    plan = GraphPlan(node_parameters(busy_scenario))
    with pytest.raises(ValueError, match="vehicles: 2 in the namespaces"):
        ComposedGraph(plan, plan)


def test_reset_flies_the_same_flight_again_whenever_it_comes(busy_scenario):
    with NodeBench("lockstep") as bench, ComposedGraph(GraphPlan(node_parameters(busy_scenario))) as graph:
        torques = bench.listen("torque/command")
        graph.wait_until_connected()
        bench.connect()
        graph.run(lambda samples: samples < 150)  # into the dropouts, less than a second: no gap to go by
        client = graph.nodes["reference"].create_client(Trigger, "plant/reset")
        answer = client.call_async(Trigger.Request())
        while not (answer.done() and graph.nodes["plant"].flight.finished):
            graph._slice.spin(0.05)
        flown = fly(busy_scenario)
        wanted = flown.torque[flown.delivered]
        bench.until(lambda: len(torques) > len(wanted) + 50)
        bench.until(lambda: stamps_of(torques)[-1] == flown.stamp_ns[flown.delivered][-1])
    again = [[m.vector.x, m.vector.y, m.vector.z] for m in torques[-len(wanted) :]]
    np.testing.assert_array_equal(again, wanted)


def stamps_of(messages):
    return [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in messages]
