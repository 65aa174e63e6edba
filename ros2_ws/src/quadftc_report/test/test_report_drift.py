"""The drift of an estimate is measured, and put down to the gyro's bias only where that explains it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3, Vector3Stamped
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from quadftc_bags.bag import Bag, read_bag
from quadftc_bags.writer import BagWriter
from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import Flight
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Scenario, node_parameters, parse_scenario
from quadftc_flight.summary import summary
from quadftc_model.samples import AXES
from quadftc_report.comparison import compare
from quadftc_report.drift import measure_drift
from quadftc_report.real_sensors import beyond_the_paper

BIAS_DEG = np.array([0.5, -0.3, 0.2])  # deg/s
TEXT = """
name: biased
duration: 4 s
rate: 50 Hz
vehicle: qball_x4
sensors: {gyro_bias: 1 deg/s}
faults: [{kind: bias, axes: roll, value: 1 deg, start: 3}]
schemes:
  mine: {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc}
  plain: {controller: smc}
"""


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(TEXT)


@pytest.fixture(scope="module")
def still(scenario) -> Flight:
    """A vehicle that does not move, and an estimate that is right."""
    flight = fly(node_parameters(scenario, "plain"))
    zeros = np.zeros((len(flight), 3))
    fault = np.where(flight.time[:, None] >= 3.0, np.radians([1.0, 0.0, 0.0]), 0.0)
    return dataclasses.replace(
        flight, angles=zeros, body_rate=zeros, reference=zeros, fault=fault, fault_estimate=fault
    )


@pytest.fixture(scope="module")
def biased_bag(tmp_path_factory, still) -> Bag:
    """A bag of that vehicle, whose gyro says its bias."""
    directory = tmp_path_factory.mktemp("runs") / "bag"
    with BagWriter(directory) as writer:
        writer.add_topic("/imu/data", "sensor_msgs/msg/Imu", QoSProfile(depth=10))
        writer.add_topic("/plant/rate", "geometry_msgs/msg/Vector3Stamped", QoSProfile(depth=10))
        x, y, z = np.radians(BIAS_DEG).tolist()
        for stamp in still.stamp_ns.tolist():
            header = Header(stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9))
            imu = Imu(header=header, angular_velocity=Vector3(x=x, y=y, z=z))
            writer.write("/imu/data", serialize_message(imu), stamp, stamp)
            writer.write("/plant/rate", serialize_message(Vector3Stamped(header=header)), stamp, stamp)
    return read_bag(directory)


def made_run(scenario: Scenario, scheme: str, flight: Flight, bag: Bag) -> RecordedRun:
    chosen = scenario.scheme(scheme)
    return RecordedRun(
        name=f"biased-{scheme}",
        path=Path(scheme),
        bag=bag,
        scenario=scenario,
        scheme=chosen,
        parameters={},
        flight=flight,
        summary=summary(flight, scenario, chosen, None),
        versions={},
    )


def drifting(still: Flight, rate_deg: np.ndarray, tracking: float = 1.0) -> Flight:
    """The estimate runs away at a rate [deg/s] (3,), and the vehicle after it."""
    walk = np.radians(rate_deg) * still.time[:, None]
    return dataclasses.replace(still, fault_estimate=still.fault + walk, angles=tracking * walk)


def text_of(scenario, flight, plain, bag) -> str:
    runs = [made_run(scenario, "mine", flight, bag), made_run(scenario, "plain", plain, bag)]
    return "\n".join(item.text for item in beyond_the_paper(compare(runs)))


def test_drift_and_bias_are_measured_over_the_healthy_time(scenario, still, biased_bag):
    drift = measure_drift(made_run(scenario, "mine", drifting(still, -BIAS_DEG, 0.0), biased_bag))
    assert (drift.start, drift.stop) == (0.0, pytest.approx(2.98))
    for axis, bias in zip(AXES, BIAS_DEG, strict=True):
        found = drift.axes[axis]
        assert found.bias == pytest.approx(bias, abs=1e-9)
        assert found.slope == pytest.approx(-bias, abs=1e-9)
        assert found.expected == pytest.approx(-bias, abs=0.01)
        assert found.error_at_end == pytest.approx(-bias * still.time[-1], abs=1e-6)


def test_bias_of_another_axis_explains_drift_when_the_vehicle_is_tilted(scenario, still, biased_bag):
    pitch = np.radians(40.0)
    tilted = dataclasses.replace(still, angles=np.tile([0.0, pitch, 0.0], (len(still), 1)))
    drift = measure_drift(made_run(scenario, "mine", tilted, biased_bag))
    p, q, r = np.radians(BIAS_DEG)
    assert np.radians(drift.axes["roll"].expected) == pytest.approx(-(p + np.tan(pitch) * r), rel=1e-6)
    assert np.radians(drift.axes["pitch"].expected) == pytest.approx(-q, rel=1e-6)


def test_estimate_that_runs_away_with_the_bias_is_told_and_why(scenario, still, biased_bag):
    text = text_of(scenario, drifting(still, -BIAS_DEG), still, biased_bag)
    assert "the gyro is biased by 0.5 (roll), -0.3 (pitch), 0.2 deg/s (yaw)" in text
    assert "changes at -0.5 (roll), 0.3 (pitch)" in text
    assert "On every axis the drift is the gyro's bias, within 10 %." in text
    assert "Here this fault tolerance is WORSE THAN NONE on every axis." in text
    assert "three invariant zeros at s = 0" in text


def test_estimate_that_does_not_follow_the_bias_is_not_blamed(scenario, still, biased_bag):
    moving = drifting(still, np.array([0.3, -0.3, 0.3]), 0.0)
    leaning = dataclasses.replace(still, angles=still.angles + 0.01)
    for flight in (still, moving):
        text = text_of(scenario, flight, leaning, biased_bag)
        assert "the estimate does not follow it" in text
        assert "invariant zeros" not in text
        assert "better than none on every axis" in text


def test_recording_without_a_gyro_or_a_healthy_time_tells_no_drift(scenario, still, tmp_path):
    empty = Bag(tmp_path)
    assert measure_drift(made_run(scenario, "mine", still, empty)) is None
    text = text_of(scenario, still, still, empty)
    assert "cannot be told from this recording" in text


def test_ideal_sensors_and_runs_without_observer_are_left_out(still, biased_bag):
    ideal = parse_scenario(TEXT.replace("gyro_bias: 1 deg/s", "grade: ideal"))
    assert beyond_the_paper(compare([made_run(ideal, "mine", still, biased_bag)])) == []
    real = parse_scenario(TEXT)
    assert beyond_the_paper(compare([made_run(real, "plain", still, biased_bag)])) == []
