"""A flight comes back from a bag as it was."""

import dataclasses

import numpy as np
import pytest
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from flight_messages import TYPES, messages_at
from message_objects import FaultStatusWriter
from quadftc_bags.bag import BagError, read_bag
from quadftc_bags.writer import BagWriter
from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import Flight, flight_from_bag, onset_ns
from quadftc_flight.scenario import parse_scenario
from quadftc_model.samples import FaultEstimate

TEXT = """
duration: 2 s
rate: 50 Hz
vehicle: qball_x4
sensors: {grade: mems}
references: [{kind: step, angles: [5 deg, 0, 0], start: 0.2, stop: 1}]
disturbances: [{kind: constant, amplitude: [0.1, 0, 0.02]}]
faults:
  - {kind: bias, axes: roll, value: 1 deg, start: 0.5}
  - {kind: dropout, channel: imu, start: 1.0, stop: 1.2}
schemes: {only: {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc}}
"""


@pytest.fixture(scope="module")
def flown() -> Flight:
    flight = fly(parse_scenario(TEXT))
    assert 0 < (~flight.delivered).sum() < len(flight)
    said = (flight.delivered & (flight.time > 0.6))[:, None] & np.array([True, False, True])
    onset = np.where(said, flight.stamp_ns[0] + np.array([500_000_000, 0, 570_000_001]), 0)
    return dataclasses.replace(flight, fault_onset_ns=onset)


def record(flight: Flight, directory, leave_out=(), namespace="/") -> None:
    rng = np.random.default_rng(1)
    with BagWriter(directory) as writer:
        for topic, type_name in TYPES.items():
            writer.add_topic(namespace + topic, type_name, QoSProfile(depth=10))
        for row in range(len(flight)):
            for topic, message in messages_at(flight, row):
                if topic not in leave_out:
                    arrival = int(flight.stamp_ns[row] + rng.integers(0, 10**8))  # out of order
                    writer.write(namespace + topic, serialize_message(message), arrival, arrival)


@pytest.mark.parametrize("namespace", ["/", "/drone1/"])
def test_a_recorded_flight_is_the_flight_bit_for_bit(flown, tmp_path, namespace):
    record(flown, tmp_path / "bag", namespace=namespace)
    read = flight_from_bag(read_bag(tmp_path / "bag"))
    for field in dataclasses.fields(Flight):
        expected, found = getattr(flown, field.name), getattr(read, field.name)
        assert found.dtype == expected.dtype, field.name
        assert found.tobytes() == expected.tobytes(), field.name


def test_onset_in_a_flight_is_the_one_in_the_message():
    rng = np.random.default_rng(1)
    for stamp_ns in rng.integers(10**9, 2 * 10**18, 200).tolist():
        age = np.append(rng.uniform(0.0, 0.9, 2), -1.0)
        estimate = FaultEstimate(np.zeros(3), -np.ones(3), np.full(3, 3, np.uint8), age, None)
        onset = [time.sec * 10**9 + time.nanosec for time in FaultStatusWriter()(stamp_ns, estimate).onset]
        assert onset_ns(stamp_ns, age).tolist() == onset


def test_a_topic_that_is_missing_leaves_its_columns_unknown(flown, tmp_path):
    record(flown, tmp_path / "bag", leave_out=("fault/status", "fault/dropped", "torque/command"))
    read = flight_from_bag(read_bag(tmp_path / "bag"))
    assert len(read) == flown.delivered.sum()
    assert read.delivered.all()
    assert np.isnan(read.torque).all()
    assert (read.fault_state == 255).all()
    assert np.array_equal(read.angles, flown.angles[flown.delivered])


def test_a_bag_without_imu_is_refused(flown, tmp_path):
    record(flown, tmp_path / "bag", leave_out=("imu/data", "fault/dropped"))
    with pytest.raises(BagError, match="no message on imu/data"):
        flight_from_bag(read_bag(tmp_path / "bag"))
