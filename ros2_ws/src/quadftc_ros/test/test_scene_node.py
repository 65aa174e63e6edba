"""The scene: poses, markers and thrust of a vehicle, for viewers."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Pose, PoseStamped, Vector3Stamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from visualization_msgs.msg import MarkerArray

from message_objects import VectorWriter
from node_bench import NodeBench, imu_message
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import RotorCondition
from quadftc_model.vehicle import load_vehicle
from quadftc_ros.latest import Latest
from quadftc_ros.motion_wire import OdometryWire, RotorsWire
from quadftc_ros.rotor_wire import RotorConditionWire
from quadftc_ros.scene_node import SceneNode
from quadftc_ros.wire import VectorWire

SECOND = 1_000_000_000  # ns
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def test_scene_shows_truth_measured_and_thrust():
    with NodeBench() as bench:
        node = bench.run(SceneNode, frame_rate=60.0, frame_prefix="uav1/")
        told = {"scene/truth": PoseStamped, "scene/measured": PoseStamped, "scene/markers": MarkerArray}
        heard = {topic: [] for topic in told}
        readers = [
            bench.tester.create_subscription(kind, topic, heard[topic].append, BEST_EFFORT)
            for topic, kind in told.items()
        ]
        imu, truth = (
            bench.tester.create_publisher(kind, topic, 10)
            for kind, topic in ((Imu, "imu/data"), (Vector3Stamped, "plant/attitude"))
        )
        bench.until(lambda: all(reader.get_publisher_count() for reader in readers))
        bench.until(lambda: imu.get_subscription_count() and truth.get_subscription_count())
        stamps = iter(range(SECOND, 100 * SECOND, SECOND // 100))

        def seen():
            stamp_ns = next(stamps)
            imu.publish(imu_message(stamp_ns, angles=(0.2, 0.0, 0.0)))
            truth.publish(VectorWriter("map")(stamp_ns, np.array([0.1, 0.0, 0.0])))
            return all(heard.values())

        bench.until(seen)
    rolls = [math.degrees(roll_of(heard[f"scene/{role}"][-1])) for role in ("truth", "measured")]
    assert rolls == pytest.approx([math.degrees(0.1), math.degrees(0.2)])
    frames = [each.child_frame_id for each in node._frames(SECOND, {"truth": Pose(), "measured": Pose()})]
    assert frames == ["uav1/base_link_measured", "uav1/base_link", "uav1/imu_link"]
    names = [marker.ns for marker in heard["scene/markers"][-1].markers]
    assert {name: names.count(name) for name in set(names)} == {"truth": 18, "measured": 8, "thrust": 4}


def roll_of(message):
    turn = message.pose.orientation
    return euler_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w]))[0]


def test_latest_forgets_what_is_silent_and_counts_thrust_by_speed():
    vehicle = load_vehicle("x500")
    latest = Latest(vehicle, "free_flight")
    speeds = np.full(4, vehicle.hover_speed)
    latest.put("rotors/speed", RotorsWire(4)(SECOND, speeds))
    latest.put("plant/odometry", OdometryWire()(SECOND, np.array([1.0, 2.0, 3.0]), LEVEL, *np.zeros((2, 3))))
    assert float(np.sum(latest.thrusts())) == pytest.approx(vehicle.weight)
    assert latest.position().tolist() == [1.0, 2.0, 3.0]
    weak = RotorCondition(np.array([0.5, 1.0, 1.0, 1.0]), np.full(4, np.inf), np.zeros(4, bool), np.zeros(4))
    latest.put("rotors/fault", RotorConditionWire(4)(SECOND, weak))
    assert latest.thrusts() == pytest.approx(vehicle.weight / 4.0 * weak.effectiveness)
    latest.put("plant/attitude", VectorWire("map")(3 * SECOND, np.zeros(3)))
    assert latest.thrusts().tolist() == [0.0] * 4
    assert latest.position().tolist() == [0.0, 0.0, 0.0]
    assert set(latest.attitudes()) == {"truth"}


def test_latest_shares_torque_among_rotors_of_a_test_stand():
    vehicle = load_vehicle("qball_x4")
    latest = Latest(vehicle, "test_stand")
    torque = np.array([0.5, 0.0, 0.0])
    latest.put("torque/command", VectorWire("base_link")(SECOND, torque))
    thrusts = latest.thrusts()
    assert vehicle.rotors.positions[:, 1] @ thrusts == pytest.approx(torque[0])
    latest.put("imu/data", b"no message at all")
    latest.put("imu/corrected", b"none")
    assert latest.attitudes() == {}
