"""What autopilots publish and take, to and from this project's units and frames (docs/on_your_vehicle.md).

Sources: PX4, msg/VehicleAttitude.msg, msg/SensorCombined.msg, msg/VehicleTorqueSetpoint.msg and
src/lib/control_allocation/control_allocation/ControlAllocationPseudoInverse.cpp; ArduPilot,
libraries/AP_DDS/AP_DDS_Client.cpp.
"""

from __future__ import annotations

import math

import numpy as np

from quadftc_model.arrays import Quaternion, Scalar, Vector, clip, namespace
from quadftc_model.frames import enu_flu_from_ned_frd, flu_from_frd
from quadftc_model.rotations import earth_z_in_body
from quadftc_model.samples import ImuSample
from quadftc_model.vehicle import Vehicle

SMALL = 1e-3  # of PX4's mix; an element below is none


def px4_imu(q_wxyz: Quaternion, gyro_frd: Vector, force_frd: Vector) -> ImuSample:
    """IMU sample of ``q`` of VehicleAttitude, ``gyro_rad`` and ``accelerometer_m_s2`` of SensorCombined."""
    xp = namespace(q_wxyz)
    parts = enu_flu_from_ned_frd(q_wxyz), flu_from_frd(gyro_frd), flu_from_frd(force_frd)
    return ImuSample(*parts, *(xp.isfinite(part).all(axis=-1) for part in parts))


def ardupilot_imu(
    orientation: Quaternion, gyro_frd: Vector, force_frd: Vector, w_first: bool = True
) -> ImuSample:
    """IMU sample of ArduPilot's sensor_msgs/Imu, whose frame is ``base_link_ned``.

    ``orientation`` are its fields x, y, z, w. ``w_first``: AP_DDS writes the components w, x, y, z into them;
    False: as their names say.
    """
    q_wxyz = orientation if w_first else orientation[..., [3, 0, 1, 2]]
    return px4_imu(q_wxyz, gyro_frd, force_frd)


def tilt_disagreement(sample: ImuSample) -> Scalar:
    """Angle [rad] (...) between up by the attitude and up by the specific force; near 0 at rest."""
    xp = namespace(sample.q_xyzw)
    force = sample.specific_force
    size = xp.sqrt(xp.sum(force * force, axis=-1))
    along = xp.sum(force * earth_z_in_body(sample.q_xyzw), axis=-1)
    return xp.arccos(clip(along / size, -1.0, 1.0))


def px4_full_torque(vehicle: Vehicle) -> Vector:
    """Torque [N m] (3,) that PX4's allocation makes of a setpoint of 1 about each axis.

    B has the torques and thrusts of the rotors at full command, M is its pseudo-inverse. PX4 divides its
    columns for roll and pitch by the larger of sqrt(sum m² / (k / 2)), with k elements m other than zero. It
    divides the column for yaw by its largest element. As B M = 1, the torque is one over that divisor. It
    holds where the rotors follow their command linearly (THR_MDL_FAC) and CA_ROTOR* are those of the vehicle.
    """
    rotors = vehicle.rotors
    full = rotors.thrust_gain * (rotors.command_max - rotors.command_idle)  # N, of one rotor
    mix = vehicle.force_allocation[:, 1:] / full
    tilt = max(
        math.sqrt(float(np.sum(column**2)) / (np.count_nonzero(np.abs(column) > SMALL) / 2.0))
        for column in mix.T[:2]
    )
    return 1.0 / np.array([tilt, tilt, float(np.max(-mix[:, 2]))])  # PX4's yaw is about z, down


def px4_torque(torque: Vector, full_torque: Vector, limit: float = 1.0) -> Vector:
    """``xyz`` of VehicleTorqueSetpoint (..., 3): a torque [N m], FLU, over the full one, within a limit."""
    return clip(flu_from_frd(torque) / full_torque, -limit, limit)
