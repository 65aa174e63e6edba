"""The messages that the graph publishes in a flight, made of the flight."""

from geometry_msgs.msg import Vector3, Vector3Stamped
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from quadftc_msgs.msg import AttitudeReference, ControlStatus, FaultStatus
from quadftc_ros.conversions import time_message

VECTOR_TOPICS = {
    "plant/attitude": "angles",
    "plant/rate": "body_rate",
    "disturbance/applied": "disturbance",
    "fault/injected": "fault",
    "fault/estimate": "fault_estimate",
    "disturbance/estimate": "disturbance_estimate",
    "torque/command": "torque",
}
TYPES = {
    **dict.fromkeys(VECTOR_TOPICS, "geometry_msgs/msg/Vector3Stamped"),
    "imu/data": "sensor_msgs/msg/Imu",
    "fault/dropped": "std_msgs/msg/Header",
    "fault/status": "quadftc_msgs/msg/FaultStatus",
    "attitude/reference": "quadftc_msgs/msg/AttitudeReference",
    "control/status": "quadftc_msgs/msg/ControlStatus",
}


def messages_at(flight, row):
    """Yield topics and messages with the stamp of a row of a flight."""
    header = Header(stamp=time_message(int(flight.stamp_ns[row])))
    for topic, name in VECTOR_TOPICS.items():
        if flight.delivered[row] or topic in ("plant/attitude", "plant/rate", "disturbance/applied"):
            yield topic, Vector3Stamped(header=header, vector=_vector(getattr(flight, name)[row]))
    if not flight.delivered[row]:
        yield "fault/injected", Vector3Stamped(header=header)  # the injector says so of one withheld, too
        yield "fault/dropped", header
        return
    yield "imu/data", Imu(header=header, angular_velocity=_vector(flight.body_rate[row]))
    yield "attitude/reference", AttitudeReference(header=header, angles=_vector(flight.reference[row]))
    state, std_dev = flight.fault_state[row], _vector(flight.fault_std_dev[row])
    onset = [time_message(ns) for ns in flight.fault_onset_ns[row].tolist()]
    yield "fault/status", FaultStatus(header=header, state=state, std_dev=std_dev, onset=onset)
    error, sliding = _vector(flight.error[row]), _vector(flight.sliding_variable[row])
    saturated = flight.saturated[row].tolist()
    status = ControlStatus(header=header, error=error, sliding_variable=sliding, saturated=saturated)
    yield "control/status", status


def _vector(row):
    return Vector3(x=row[0], y=row[1], z=row[2])
