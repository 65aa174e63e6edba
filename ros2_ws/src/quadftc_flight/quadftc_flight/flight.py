# ruff: noqa: RUF009  (the columns are fields that carry their source)
"""A flight as arrays: what was true, estimated and commanded, a row for each stamp of the IMU.

A `Flight` comes from the closed loop without ROS or, by `flight_from_bag`, from the recording of a graph. In
lock-step both give the same arrays, bit for bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.reported import note_reports, reports_from
from quadftc_model.arrays import AnyArray
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import ABSENT
from quadftc_model.stepper import NANOSECONDS_PER_SECOND

if TYPE_CHECKING:  # reading bags takes libraries that the closed loop does without
    from jaxtyping import Float, Int

    from quadftc_bags.bag import Bag, Series

Floats = NDArray[np.float64]

NO_STATE = 255  # fault state of a row without diagnosis
DIAGNOSIS = "diagnosis"  # the topic, whose messages hold until the next one
ROTORS = "rotors/status"


def _column(
    topic: str, field: str = "vector", unknown: float | np.generic = np.nan, of_rotors: bool = False
) -> Any:
    """Three numbers a row, of which a recording tells by a topic; ``unknown`` where nothing is known.

    Those ``of_rotors`` are as many as there are rotors, and none on the test stand.
    """
    metadata = {"source": (topic, field), "unknown": np.full(3, unknown), "of_rotors": of_rotors}
    return dataclasses.field(metadata=metadata)


def _rotor_column(topic: str, field: str = "vector", unknown: float | np.generic = np.nan) -> Any:
    """As `_column`, with one number for each rotor."""
    return _column(topic, field, unknown, of_rotors=True)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Flight:
    """One row for each IMU sample that was taken, in the order of the stamps.

    What is unknown in a row is NaN (states: ``NO_STATE``; onsets: 0; ``saturated`` and ambiguities: False).
    Of a withheld sample only the motion and the disturbance are known; in a bag, what is not missing.
    """

    stamp_ns: NDArray[np.int64]  # (n,) when the sample was taken
    time: Floats  # (n,) scenario time [s]: since the first sample
    delivered: NDArray[np.bool_]  # (n,) False: the sample was withheld (dropout); the others are (n, 3)
    angles: Floats = _column("plant/attitude")  # true Euler angles [rad]
    body_rate: Floats = _column("plant/rate")  # true [rad/s]
    reference: Floats = _column("attitude/reference", "angles")  # Euler angles [rad]
    fault: Floats = _column("fault/injected")  # true fault of the attitude [rad]
    gyro_fault: Floats = _column("fault/injected/gyro")  # true [rad/s]
    accelerometer_fault: Floats = _column("fault/injected/accelerometer")  # true [m/s²]
    fault_estimate: Floats = _column("fault/estimate")  # [rad]
    fault_std_dev: Floats = _column("fault/status", "std_dev")  # [rad]; -1: this observer gives none
    # as in quadftc_msgs/FaultStatus; and the stamp of the onset of the present fault, 0: none
    fault_state: NDArray[np.uint8] = _column("fault/status", "state", np.uint8(NO_STATE))
    fault_onset_ns: NDArray[np.int64] = _column("fault/status", "onset_ns", np.int64(0))
    # what the topic `diagnosis` said last; probabilities [1] and std_dev -1: this observer gives none
    attitude_state: NDArray[np.uint8] = _column(DIAGNOSIS, unknown=np.uint8(NO_STATE))  # faulty if absent
    attitude_probability: Floats = _column(DIAGNOSIS)  # that this axis of the attitude is faulty
    attitude_ambiguous: NDArray[np.bool_] = _column(DIAGNOSIS, unknown=np.False_)  # it may be the gyro
    gyro_state: NDArray[np.uint8] = _column(DIAGNOSIS, unknown=np.uint8(NO_STATE))  # NO_STATE: not watched
    gyro_estimate: Floats = _column(DIAGNOSIS)  # of its fault [rad/s]
    gyro_std_dev: Floats = _column(DIAGNOSIS)  # [rad/s]
    gyro_onset_ns: NDArray[np.int64] = _column(DIAGNOSIS, unknown=np.int64(0))
    gyro_probability: Floats = _column(DIAGNOSIS)
    gyro_ambiguous: NDArray[np.bool_] = _column(DIAGNOSIS, unknown=np.False_)  # it may be the attitude
    accelerometer_state: NDArray[np.uint8] = _column(DIAGNOSIS, unknown=np.uint8(NO_STATE))
    accelerometer_estimate: Floats = _column(DIAGNOSIS)  # of its fault [m/s²]
    accelerometer_std_dev: Floats = _column(DIAGNOSIS)  # [m/s²]
    accelerometer_onset_ns: NDArray[np.int64] = _column(DIAGNOSIS, unknown=np.int64(0))
    disturbance: Floats = _column("disturbance/applied")  # true, as an angular acceleration [rad/s²]
    disturbance_estimate: Floats = _column("disturbance/estimate")  # [rad/s²]
    torque: Floats = _column("torque/command")  # command [N m]
    # in free flight, earth axes
    position: Floats = _column("plant/odometry", "pose.pose.position")  # true [m]
    position_reference: Floats = _column("position/reference", "pose.position")  # [m]
    position_estimate: Floats = _column("position/estimate", "pose.pose.position")  # [m]
    # of the rotors, (n, rotors)
    rotor_effectiveness: Floats = _rotor_column("rotors/fault", "effectiveness")  # true [1]; 0: off
    rotor_speeds: Floats = _rotor_column("rotors/speed", "velocity")  # true [rad/s]
    # what the diagnosis says of them; NO_STATE and NaN: it does not diagnose rotors
    rotor_state: NDArray[np.uint8] = _rotor_column(ROTORS, "state", np.uint8(NO_STATE))
    rotor_estimate: Floats = _rotor_column(ROTORS, "effectiveness")  # [1]
    rotor_std_dev: Floats = _rotor_column(ROTORS, "std_dev")  # [1]
    rotor_probability: Floats = _rotor_column(ROTORS, "probability")  # that it is faulty [1]
    rotor_ambiguous: NDArray[np.bool_] = _rotor_column(ROTORS, "ambiguous", np.False_)
    rotor_onset_ns: NDArray[np.int64] = _rotor_column(DIAGNOSIS, unknown=np.int64(0))
    error: Floats = _column("control/status", "error")  # attitude less reference, to the controller [rad]
    sliding_variable: Floats = _column("control/status", "sliding_variable")  # [rad/s]
    saturated: NDArray[np.bool_] = _column("control/status", "saturated", np.False_)  # the torque was cut

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def first(self, rows: int) -> Flight:
        """Return the beginning of the flight."""
        return Flight(**{field.name: getattr(self, field.name)[:rows] for field in dataclasses.fields(self)})


_KNOWN_WHEN_WITHHELD = ("angles", "body_rate", "disturbance", "position", "rotor_speeds")
_COLUMNS = {field.name: field.metadata for field in dataclasses.fields(Flight) if field.metadata}
VECTORS = tuple(
    name for name, column in _COLUMNS.items() if np.isnan(column["unknown"]).all() and not column["of_rotors"]
)


def columns_by_topic(flight: Flight) -> dict[str, dict[str, NDArray[np.generic]]]:
    """Return the columns by the topic and the field that tell of them."""
    found: dict[str, dict[str, NDArray[np.generic]]] = {}
    for name, column in _COLUMNS.items():
        topic, field = column["source"]
        found.setdefault(topic, {})[field] = getattr(flight, name)
    return found


def unknown_flight(stamp_ns: Int[NDArray[np.int64], " n"], rotors: int = 0) -> Flight:
    """Return a flight of which nothing is known but the stamps; its columns are there to be filled.

    In free flight it has so many ``rotors``.
    """
    count = len(stamp_ns)
    return Flight(
        stamp_ns=stamp_ns,
        time=(stamp_ns - stamp_ns[0]) / NANOSECONDS_PER_SECOND,
        delivered=np.zeros(count, np.bool_),
        **{name: np.tile(_unknown(column, rotors), (count, 1)) for name, column in _COLUMNS.items()},
    )


def _unknown(column: Mapping[str, Any], rotors: int) -> AnyArray:
    """Return a row of a column of which nothing is known."""
    unknown = column["unknown"]
    return np.resize(unknown, rotors) if column["of_rotors"] else unknown


def onset_ns(stamp_ns: int | NDArray[np.int64], onset_age: Floats) -> NDArray[np.int64]:
    """Stamp of the onset of a fault as quadftc_msgs/FaultStatus says it, 0 without one: by its age [s]."""
    there = onset_age >= 0.0  # false for NaN
    age_ns = np.round(np.where(there, onset_age, 0.0) * NANOSECONDS_PER_SECOND).astype(np.int64)
    return np.where(there, stamp_ns - age_ns, 0)


def flight_from_bag(bag: Bag) -> Flight:
    """Join the topics of a recorded flight by stamp, those of ``imu/data`` and ``fault/dropped``.

    A missing topic leaves its columns unknown; no IMU sample, or an undecodable topic, is a BagError.
    """
    from quadftc_bags.bag import BagError

    delivered_ns, dropped_ns = (
        np.unique(bag.series(topic).stamp_ns) if has_messages(bag, topic) else np.empty(0, np.int64)
        for topic in ("imu/data", "fault/dropped")
    )
    stamp_ns = np.union1d(delivered_ns, dropped_ns)
    if len(stamp_ns) == 0:
        raise BagError(f"{bag.path}: no message on imu/data")
    flight = unknown_flight(stamp_ns, _count_rotors(bag))
    flight.delivered[:] = np.isin(stamp_ns, delivered_ns)
    for name, column in _COLUMNS.items():
        known = flight.delivered | (name in _KNOWN_WHEN_WITHHELD)
        topic, field = column["source"]
        if topic == DIAGNOSIS:
            continue
        joined = _join_topic(bag, topic, field, stamp_ns, getattr(flight, name)[0])
        if name == "rotor_effectiveness":
            limit = _join_topic(bag, topic, "speed_limit", stamp_ns, getattr(flight, name)[0])
            joined = np.where(limit <= 0.0, 0.0, joined)  # as `quadftc_sim.rotor_fault.true_effectiveness`
        getattr(flight, name)[known] = joined[known]
    if has_messages(bag, DIAGNOSIS):
        note_reports(flight, reports_from(bag.series(DIAGNOSIS)))
    return flight


def _count_rotors(bag: Bag) -> int:
    """Return how many rotors the recording of a free flight tells of; 0 of another one."""
    if not has_messages(bag, "rotors/speed"):
        return 0
    return min(map(len, bag.series("rotors/speed")["velocity"]))


class ImuReadings(NamedTuple):
    """What an IMU said in the rows of a flight; NaN where it said nothing."""

    angles: Float[Floats, "n 3"]  # Euler angles [rad]
    body_rate: Float[Floats, "n 3"]  # [rad/s]


def imu_readings_from_bag(bag: Bag, topic: str, stamp_ns: Int[NDArray[np.int64], " n"]) -> ImuReadings:
    """Join the samples of an IMU, a topic of type sensor_msgs/Imu, by the stamps of the rows of a flight."""
    nothing = np.full(9, np.nan)
    angles = np.asarray(
        euler_from_quaternion(_join_topic(bag, topic, "orientation_xyzw", stamp_ns, nothing[:4]))
    )
    body_rate = _join_topic(bag, topic, "angular_velocity", stamp_ns, nothing[:3])
    for values, field in ((angles, "orientation_covariance"), (body_rate, "angular_velocity_covariance")):
        values[_join_topic(bag, topic, field, stamp_ns, nothing)[:, 0] == ABSENT] = np.nan
    return ImuReadings(angles, body_rate)


def join_rows(series: Series, field: str, stamp_ns: NDArray[np.int64], unknown: AnyArray) -> AnyArray:
    """Return a field (n, k) of the first message with each stamp (n,); ``unknown`` (k,) without one."""
    column = np.tile(unknown, (len(stamp_ns), 1))
    stamps, first = np.unique(series.stamp_ns, return_index=True)
    _, here, there = np.intersect1d(stamp_ns, stamps, assume_unique=True, return_indices=True)
    if len(here):
        column[here] = series[field][first[there]]
    return column


def _join_topic(bag: Bag, topic: str, field: str, stamp_ns: NDArray[np.int64], unknown: AnyArray) -> AnyArray:
    nothing = np.tile(unknown, (len(stamp_ns), 1))
    if not has_messages(bag, topic):
        return nothing
    series = bag.series(topic)
    if topic == ROTORS and np.shape(series[field])[1:] != unknown.shape:  # no rotors are diagnosed
        return nothing
    return join_rows(series, field, stamp_ns, unknown)


def has_messages(bag: Bag, topic: str) -> bool:
    """Return whether there is a message on a topic, whose name is relative to a namespace."""
    return any(f"/{name.strip('/')}".endswith(f"/{topic}") and bag.topics[name].count for name in bag.topics)
