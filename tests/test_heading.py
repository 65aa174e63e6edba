"""A flight in the graph with a magnetometer: from its bag, the attitude estimator knows the heading."""

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from quadftc_fdi.attitude_estimator import AttitudeEstimator, EstimatorParameters
from quadftc_flight.scenario import parse_scenario
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import ImuSample

FLIGHT = """
name: hover_with_magnetometer
duration: 6 s
rate: 250 Hz
vehicle: x500
plant: {kind: free_flight, start: [0, 0, 1]}
sensors: {grade: mems, gyro_bias: 2 deg/s}
position_sensor: {grade: mocap}
magnetometer: {grade: mems}
barometer: {grade: mems}
schemes:
  plain: {controller: smc}
"""
TRUE = np.bool_(True)


@pytest.fixture(scope="module")
def messages(fly_graph):
    """Times [s] and messages of some topics of the bag."""
    bag, _ = fly_graph(parse_scenario(FLIGHT), "plain")
    found = {"/imu/data": [], "/imu/mag": [], "/imu/static_pressure": [], "/plant/attitude": []}
    with AnyReader([bag]) as reader:
        chosen = [connection for connection in reader.connections if connection.topic in found]
        for connection, _, raw in reader.messages(chosen):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            found[connection.topic].append((stamp.sec * 10**9 + stamp.nanosec, message))
    return found


def heading_errors(messages, with_field):
    """Heading less the true one, relative to that at the start without a magnetometer [deg]."""
    estimator = AttitudeEstimator(EstimatorParameters(rate=250.0, mag_rate=20.8 if with_field else 0.0))
    fields = {stamp_ns: message.magnetic_field for stamp_ns, message in messages["/imu/mag"]}
    truth = {stamp_ns: message.vector.z for stamp_ns, message in messages["/plant/attitude"]}
    errors = []
    for stamp_ns, message in messages["/imu/data"]:
        if with_field and (field := fields.get(stamp_ns)):
            assert estimator.take_field(np.array([field.x, field.y, field.z]))
        rate, force = message.angular_velocity, message.linear_acceleration
        sample = ImuSample(
            np.array([0.0, 0.0, 0.0, 1.0]),
            np.array([rate.x, rate.y, rate.z]),
            np.array([force.x, force.y, force.z]),
            ~TRUE,
            TRUE,
            TRUE,
        )
        estimate = estimator.step(stamp_ns, sample)
        yaw = euler_from_quaternion(estimate.sample.q_xyzw)[2]
        errors.append(np.degrees(np.angle(np.exp(1j * (yaw - truth[stamp_ns])))))
    return np.array(errors)


def test_the_magnetometer_keeps_the_heading_that_drifts_without(messages):
    known, drifting = (heading_errors(messages, with_field) for with_field in (True, False))
    assert np.abs(known[-500:]).max() < 3.0  # the last 2 s; HEADING of the estimator, one standard deviation
    assert np.abs(drifting).max() > 2.0 * np.abs(known[-500:]).max()


def test_pressure_and_field_come_with_frame_and_variance(messages):
    _, pressure = messages["/imu/static_pressure"][0]
    _, field = messages["/imu/mag"][0]
    assert pressure.header.frame_id == field.header.frame_id == "imu_link"
    assert pressure.variance == pytest.approx(1.2**2 + 10.0**2)
    assert field.magnetic_field_covariance[[0, 4, 8]] == pytest.approx([3.4e-13] * 3)
    assert len(messages["/imu/static_pressure"]) == 300
