"""The attitude estimator node: raw samples in, imu/data with covariance out."""

import math

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import MagneticField

from message_objects import set_stamp
from node_bench import imu_message
from quadftc_fdi.attitude_estimator_node import AttitudeEstimatorNode
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_ros.conversions import stamp_of
from wired_node import Wired

PERIOD_NS = 4_000_000
FIRST_NS = 9_000_000_000


def raw(k, **fields):
    message = imu_message(FIRST_NS + k * PERIOD_NS, **fields)
    message.orientation_covariance[0] = -1.0
    return message


def angles_of(message):
    q = message.orientation
    return euler_from_quaternion(np.array([q.x, q.y, q.z, q.w]))


def answers(wired):
    return [message for topic, message in wired.take() if topic == "imu/data"]


def test_every_raw_sample_gets_an_attitude_with_its_covariance():
    tilted = (9.81 * math.sin(0.1), 0.0, 9.81 * math.cos(0.1))  # nose up is pitch of -0.1 rad
    with Wired(AttitudeEstimatorNode, "realtime", rate=250.0) as wired:
        for k in range(500):
            wired.feed("imu/data_raw", raw(k, force=tilted))
        found = answers(wired)
    assert [stamp_of(message) for message in found] == [FIRST_NS + k * PERIOD_NS for k in range(500)]
    np.testing.assert_allclose(angles_of(found[-1]), [0.0, -0.1, 0.0], atol=1e-3)
    covariance = np.reshape(found[-1].orientation_covariance, (3, 3))
    assert 0.0 < covariance[0, 0] == covariance[1, 1] < math.radians(1.0) ** 2
    assert covariance[2, 2] > found[0].orientation_covariance[8]  # nothing holds the heading
    assert np.count_nonzero(covariance) == 3
    assert found[-1].angular_velocity_covariance[0] == 0.0
    assert found[-1].header.frame_id == "imu_link"


def test_poses_and_magnetic_field_are_used_and_bad_ones_counted():
    pose = PoseStamped()
    pose.header.frame_id = "map"
    x, y, z, w = quaternion_from_euler(np.array([0.0, 0.0, 1.0])).tolist()
    pose.pose.orientation.x, pose.pose.orientation.y = x, y
    pose.pose.orientation.z, pose.pose.orientation.w = z, w
    with Wired(AttitudeEstimatorNode, "realtime", rate=250.0) as wired:
        for k in range(20):
            wired.feed("imu/data_raw", raw(k))
        set_stamp(pose.header, FIRST_NS + 15 * PERIOD_NS)
        wired.feed("mocap/pose", pose)
        wired.take()
        wired.feed("imu/data_raw", raw(20))
        (found,) = answers(wired)
        np.testing.assert_allclose(angles_of(found), [0.0, 0.0, 1.0], atol=1e-3)
        wired.feed("mocap/pose", pose)  # the same again
        field = MagneticField()
        field.header.frame_id = "imu_link"
        set_stamp(field.header, FIRST_NS + 20 * PERIOD_NS)
        wired.feed("imu/mag", field)  # zero
        counts = wired.node.diagnostics.counts
        assert counts["mocap/pose: off unit length, or not within 0.5 s of the last sample"] == 1
        assert counts["imu/mag: not finite, or zero"] == 1
        wired.call("reset", None)
        wired.feed("imu/data_raw", raw(21))
        assert angles_of(answers(wired)[0])[2] == 0.0  # the heading of the poses is forgotten


def test_it_says_how_well_the_attitude_is_known(bench):
    node = bench.run(AttitudeEstimatorNode, rate=250.0)
    send, status = bench.talk("imu/data_raw"), bench.watch_diagnostics()
    found = bench.listen("imu/data")
    bench.connect()
    name = f"{node.get_name()}: attitude"
    bench.until(lambda: name in status and status[name].level == DiagnosticStatus.WARN)
    for k in range(50):
        send(raw(k))
    bench.until(lambda: len(found) >= 1 and status[name].level == DiagnosticStatus.OK)
    values = {each.key: each.value for each in status[name].values}
    assert values["heading"] == "gyro alone: it drifts"
    assert float(values["tilt_sigma_deg"]) < 1.0
