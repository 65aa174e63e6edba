"""PX4 over uXRCE-DDS: its attitude and IMU as imu/data, torque/command as its torque setpoint.

    python px4_bridge.py --ros-args -p vehicle:=my_drone.toml -p limit:=0.0     # listens only
    python px4_bridge.py --ros-args -p vehicle:=my_drone.toml -p limit:=0.2     # a fifth of the full torque

It needs px4_msgs of your firmware's version in the workspace, and the lines of dds_topics.yaml that
docs/on_your_vehicle.md names. It neither arms nor changes the mode: the pilot does, and takes back control.
"""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3Stamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

from quadftc_model.autopilots import px4_full_torque, px4_imu, px4_torque
from quadftc_model.samples import ImuSample
from quadftc_model.vehicle import load_vehicle
from quadftc_ros.wire import ImuWire

STALE = 10_000  # µs; sensors further than that from the attitude are not paired with it with it


def sample_of(attitude: Any, sensors: Any) -> ImuSample:
    """Return the IMU sample of a VehicleAttitude and a SensorCombined."""
    fields = attitude.q, sensors.gyro_rad, sensors.accelerometer_m_s2
    return px4_imu(*(np.asarray(field, np.float64) for field in fields))


def thrust_share(throttle: float, limit: float) -> float:
    """Return the share of the full thrust that the pilot's stick [-1, 1] asks for."""
    return min(max(0.5 * (throttle + 1.0), 0.0), limit) if np.isfinite(throttle) else 0.0


class Px4Bridge(Node):
    """Between PX4 and the graph."""

    def __init__(self) -> None:
        from px4_msgs import msg as px4

        super().__init__("px4_bridge")
        self._px4, self._sensors, self._throttle = px4, None, -1.0
        self.declare_parameter("vehicle", "x500")
        self.declare_parameter("limit", 0.0)  # of the normalised torque; 0: sends nothing
        self.declare_parameter("thrust_limit", 0.8)
        self._full = px4_full_torque(load_vehicle(self.get_parameter("vehicle").value))
        self._imu, self._wire = self.create_publisher(Imu, "imu/data", qos_profile_sensor_data), ImuWire()
        names = ("OffboardControlMode", "VehicleThrustSetpoint", "VehicleTorqueSetpoint")
        topics = ("offboard_control_mode", "vehicle_thrust_setpoint", "vehicle_torque_setpoint")
        self._out = [
            self.create_publisher(getattr(px4, name), f"/fmu/in/{topic}", qos_profile_sensor_data)
            for name, topic in zip(names, topics, strict=True)
        ]
        for name, topic, callback in (
            ("SensorCombined", "sensor_combined", self._on_sensors),
            ("VehicleAttitude", "vehicle_attitude", self._on_attitude),
            ("ManualControlSetpoint", "manual_control_setpoint", self._on_stick),
        ):
            self.create_subscription(
                getattr(px4, name), f"/fmu/out/{topic}", callback, qos_profile_sensor_data
            )
        self.create_subscription(Vector3Stamped, "torque/command", self._on_torque, 10)

    def _on_sensors(self, sensors: Any) -> None:
        self._sensors = sensors

    def _on_stick(self, stick: Any) -> None:
        self._throttle = stick.throttle

    def _on_attitude(self, attitude: Any) -> None:
        if self._sensors is not None and abs(attitude.timestamp_sample - self._sensors.timestamp) < STALE:
            stamp_ns = attitude.timestamp_sample * 1000  # of this machine's clock, with UXRCE_DDS_SYNCT
            self._imu.publish(self._wire(stamp_ns, sample_of(attitude, self._sensors)))

    def _on_torque(self, command: Vector3Stamped) -> None:
        limit = self.get_parameter("limit").value
        if limit <= 0.0:
            return
        torque = np.array([command.vector.x, command.vector.y, command.vector.z])
        mode, thrust, setpoint = (publisher.msg_type() for publisher in self._out)
        mode.thrust_and_torque = True
        thrust.xyz = [0.0, 0.0, -thrust_share(self._throttle, self.get_parameter("thrust_limit").value)]
        setpoint.xyz = px4_torque(torque, self._full, limit).astype(np.float32)
        for publisher, message in zip(self._out, (mode, thrust, setpoint), strict=True):
            message.timestamp = self.get_clock().now().nanoseconds // 1000
            publisher.publish(message)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.init()
        rclpy.spin(Px4Bridge())
