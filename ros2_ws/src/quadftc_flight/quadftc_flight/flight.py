"""A flight as arrays: what was true, estimated and commanded, a row for each stamp of the IMU.

A `Flight` comes from the closed loop without ROS or, by `flight_from_bag`, from the recording of a graph. In
lock-step both give the same arrays, bit for bit.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import ABSENT
from quadftc_model.stepper import NANOSECONDS_PER_SECOND

if TYPE_CHECKING:  # reading bags takes libraries that the closed loop does without
    from jaxtyping import Float, Int

    from quadftc_bags.bag import Bag, Series

Floats = NDArray[np.float64]

NO_STATE = 255  # fault state of a row without diagnosis

_SOURCES = {
    "angles": ("plant/attitude", "vector"),
    "body_rate": ("plant/rate", "vector"),
    "disturbance": ("disturbance/applied", "vector"),
    "reference": ("attitude/reference", "angles"),
    "fault": ("fault/injected", "vector"),
    "fault_estimate": ("fault/estimate", "vector"),
    "fault_std_dev": ("fault/status", "std_dev"),
    "disturbance_estimate": ("disturbance/estimate", "vector"),
    "torque": ("torque/command", "vector"),
    "error": ("control/status", "error"),
    "sliding_variable": ("control/status", "sliding_variable"),
    "fault_state": ("fault/status", "state"),
    "fault_onset_ns": ("fault/status", "onset_ns"),
    "saturated": ("control/status", "saturated"),
}  # column of a flight -> topic, field
_KNOWN_WHEN_WITHHELD = ("angles", "body_rate", "disturbance")
_UNKNOWN = {
    "fault_state": np.full(3, NO_STATE, np.uint8),
    "fault_onset_ns": np.zeros(3, np.int64),
    "saturated": np.zeros(3, np.bool_),
}  # what stands where nothing is known; in other columns, NaN
VECTORS = tuple(name for name in _SOURCES if name not in _UNKNOWN)  # columns with three numbers


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Flight:
    """One row for each IMU sample that was taken, in the order of the stamps.

    What is unknown in a row is NaN (``fault_state``: ``NO_STATE``; ``fault_onset_ns``: 0; ``saturated``:
    False). In the row of a withheld sample this is all but the motion and the disturbance; in a bag, every
    message that is missing.
    """

    stamp_ns: NDArray[np.int64]  # (n,) when the sample was taken
    time: Floats  # (n,) scenario time [s]: since the first sample
    delivered: NDArray[np.bool_]  # (n,) False: the sample was withheld (dropout)
    angles: Floats  # (n, 3) true Euler angles [rad]
    body_rate: Floats  # (n, 3) true [rad/s]
    reference: Floats  # (n, 3) Euler angles [rad]
    fault: Floats  # (n, 3) true fault of the attitude [rad]
    fault_estimate: Floats  # (n, 3) [rad]
    fault_std_dev: Floats  # (n, 3) [rad]; -1: this observer gives none
    fault_state: NDArray[np.uint8]  # (n, 3) as in quadftc_msgs/FaultStatus
    fault_onset_ns: NDArray[np.int64]  # (n, 3) stamp of the onset of the present fault; 0: none
    disturbance: Floats  # (n, 3) true, as an angular acceleration [rad/s²]
    disturbance_estimate: Floats  # (n, 3) [rad/s²]
    torque: Floats  # (n, 3) command [N m]
    error: Floats  # (n, 3) attitude minus reference as the controller saw it [rad]
    sliding_variable: Floats  # (n, 3) [rad/s]
    saturated: NDArray[np.bool_]  # (n, 3) whether the torque was cut

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def first(self, rows: int) -> Flight:
        """Return the beginning of the flight."""
        return Flight(**{field.name: getattr(self, field.name)[:rows] for field in dataclasses.fields(self)})


def unknown_flight(stamp_ns: Int[NDArray[np.int64], " n"]) -> Flight:
    """Return a flight of which nothing is known but the stamps; its columns are there to be filled."""
    count = len(stamp_ns)
    unknown: dict[str, NDArray[Any]] = {**dict.fromkeys(VECTORS, np.full(3, np.nan)), **_UNKNOWN}
    return Flight(
        stamp_ns=stamp_ns,
        time=(stamp_ns - stamp_ns[0]) / NANOSECONDS_PER_SECOND,
        delivered=np.zeros(count, np.bool_),
        **{name: np.tile(value, (count, 1)) for name, value in unknown.items()},
    )


def onset_ns(stamp_ns: int | NDArray[np.int64], onset_age: Floats) -> NDArray[np.int64]:
    """Stamp of the onset of a fault as quadftc_msgs/FaultStatus says it, 0 without one: by its age [s]."""
    there = onset_age >= 0.0  # false for NaN
    age_ns = np.round(np.where(there, onset_age, 0.0) * NANOSECONDS_PER_SECOND).astype(np.int64)
    return np.where(there, stamp_ns - age_ns, 0)


def flight_from_bag(bag: Bag) -> Flight:
    """Join the topics of a recorded flight by stamp.

    The rows are the stamps of ``imu/data`` and ``fault/dropped``. A topic that is missing leaves its columns
    unknown. If the bag holds no IMU sample, or a topic cannot be decoded, BagError is raised.
    """
    from quadftc_bags.bag import BagError

    delivered_ns, dropped_ns = (
        np.unique(bag.series(topic).stamp_ns) if has_messages(bag, topic) else np.empty(0, np.int64)
        for topic in ("imu/data", "fault/dropped")
    )
    stamp_ns = np.union1d(delivered_ns, dropped_ns)
    if len(stamp_ns) == 0:
        raise BagError(f"{bag.path}: no message on imu/data")
    flight = unknown_flight(stamp_ns)
    flight.delivered[:] = np.isin(stamp_ns, delivered_ns)
    for name, (topic, field) in _SOURCES.items():
        column = getattr(flight, name)
        known = flight.delivered | (name in _KNOWN_WHEN_WITHHELD)
        column[known] = _join_topic(bag, topic, field, stamp_ns, column[0].copy())[known]
    return flight


class Reading(NamedTuple):
    """What an IMU said in the rows of a flight; NaN where it said nothing."""

    angles: Float[Floats, "n 3"]  # Euler angles [rad]
    body_rate: Float[Floats, "n 3"]  # [rad/s]


def reading_from_bag(bag: Bag, topic: str, stamp_ns: Int[NDArray[np.int64], " n"]) -> Reading:
    """Join the samples of an IMU, a topic of type sensor_msgs/Imu, by the stamps of the rows of a flight."""
    nothing = np.full(9, np.nan)
    angles = np.asarray(
        euler_from_quaternion(_join_topic(bag, topic, "orientation_xyzw", stamp_ns, nothing[:4]))
    )
    body_rate = _join_topic(bag, topic, "angular_velocity", stamp_ns, nothing[:3])
    for values, field in ((angles, "orientation_covariance"), (body_rate, "angular_velocity_covariance")):
        values[_join_topic(bag, topic, field, stamp_ns, nothing)[:, 0] == ABSENT] = np.nan
    return Reading(angles, body_rate)


def join_rows(series: Series, field: str, stamp_ns: NDArray[np.int64], unknown: NDArray[Any]) -> NDArray[Any]:
    """Return a field (n, k) of the messages with these stamps (n,); ``unknown`` (k,) where there is none.

    Of several messages with one stamp, the first counts.
    """
    column = np.tile(unknown, (len(stamp_ns), 1))
    stamps, first = np.unique(series.stamp_ns, return_index=True)
    _, here, there = np.intersect1d(stamp_ns, stamps, assume_unique=True, return_indices=True)
    if len(here):
        column[here] = series[field][first[there]]
    return column


def _join_topic(
    bag: Bag, topic: str, field: str, stamp_ns: NDArray[np.int64], unknown: NDArray[Any]
) -> NDArray[Any]:
    if not has_messages(bag, topic):
        return np.tile(unknown, (len(stamp_ns), 1))
    return join_rows(bag.series(topic), field, stamp_ns, unknown)


def has_messages(bag: Bag, topic: str) -> bool:
    """Return whether there is a message on a topic, whose name is relative to a namespace."""
    return any(f"/{name.strip('/')}".endswith(f"/{topic}") and bag.topics[name].count for name in bag.topics)
