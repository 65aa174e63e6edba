"""ArduPilot's DDS: /ap/imu/experimental/data (FRD, north-east-down, no covariance) as imu/data of ROS.

    python ardupilot_imu.py                                   # x, y, z, w of the message hold w, x, y, z
    python ardupilot_imu.py --ros-args -p w_first:=false      # firmware in which that is mended

At the first sample the vehicle stands still: if gravity and attitude disagree, it says so.
"""

from __future__ import annotations

import contextlib
import math

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

from quadftc_model.autopilots import ardupilot_imu, tilt_disagreement
from quadftc_model.samples import ImuSample
from quadftc_ros.wire import ImuWire

LARGEST_TILT = math.radians(10.0)  # that gravity and attitude may differ by, at rest


def sample_of(message: Imu, w_first: bool) -> ImuSample:
    """Return the sample of a message, in FLU and east-north-up."""
    q, rate, force = message.orientation, message.angular_velocity, message.linear_acceleration
    fields = (q.x, q.y, q.z, q.w), (rate.x, rate.y, rate.z), (force.x, force.y, force.z)
    return ardupilot_imu(*map(np.array, fields), w_first)


class ArduPilotImu(Node):
    """Turns samples."""

    def __init__(self) -> None:
        super().__init__("ardupilot_imu")
        self.declare_parameter("w_first", True)
        self.declare_parameter("topic", "/ap/imu/experimental/data")
        self._w_first, self._looked = self.get_parameter("w_first").value, False
        self._imu, self._wire = self.create_publisher(Imu, "imu/data", qos_profile_sensor_data), ImuWire()
        topic = self.get_parameter("topic").value
        self.create_subscription(Imu, topic, self._on_sample, qos_profile_sensor_data)

    def _on_sample(self, message: Imu) -> None:
        sample = sample_of(message, self._w_first)
        if not self._looked and tilt_disagreement(sample) > LARGEST_TILT:
            self.get_logger().warning(
                "attitude and gravity disagree: is w_first right, does the vehicle rest?"
            )
        self._looked = True
        stamp = message.header.stamp
        self._imu.publish(self._wire(stamp.sec * 1_000_000_000 + stamp.nanosec, sample))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.init()
        rclpy.spin(ArduPilotImu())
