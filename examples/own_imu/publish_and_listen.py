"""Publish an IMU, and print what the fault observer says about it: replace ``read_imu`` by your driver.

The IMU here is level and at rest; after 10 s its roll reads wrong by ``--bias`` degrees.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import Imu

from quadftc_msgs.msg import FaultStatus

RATE = 250.0  # Hz
STATES = ("starting", "healthy", "suspect", "faulty", "recovering")


class OwnImu(Node):
    """A vehicle that has an IMU and listens to its diagnosis."""

    def __init__(self, bias: float) -> None:
        super().__init__("own_imu")
        self._bias, self._count, self._states = math.radians(bias), 0, ()
        self._publisher = self.create_publisher(Imu, "imu/data", qos_profile_sensor_data)
        self.create_subscription(FaultStatus, "fault/status", self._on_status, 10)
        self.create_timer(1.0 / RATE, self._on_time)

    def read_imu(self) -> Imu:
        """Return a sample: attitude (x, y, z, w), body rate [rad/s], specific force [m/s²]; axes FLU."""
        roll = self._bias if self._count > 10.0 * RATE else 0.0
        imu = Imu()
        imu.orientation.x, imu.orientation.w = math.sin(roll / 2.0), math.cos(roll / 2.0)
        imu.linear_acceleration.z = 9.81
        return imu

    def _on_time(self) -> None:
        self._count += 1
        imu = self.read_imu()
        imu.header.stamp = self.get_clock().now().to_msg()  # when the sample was taken
        imu.header.frame_id = "imu_link"
        self._publisher.publish(imu)

    def _on_status(self, status: FaultStatus) -> None:
        states = tuple(STATES[state] for state in status.state)
        if states != self._states:
            self._states = states
            size = [round(math.degrees(getattr(status.estimate, axis)), 2) for axis in "xyz"]
            print(f"{self._count / RATE:6.2f} s: {', '.join(states)}; roll, pitch, yaw off by {size} deg")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bias", type=float, default=5.0, help="fault on roll after 10 s [deg]")
    arguments = parser.parse_args(remove_ros_args(sys.argv)[1:])
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(OwnImu(arguments.bias))
