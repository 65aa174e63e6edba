"""What a flight was worth: tracking, fault estimation, effort. Numbers for `summary.json`.

Errors are wrapped into [-pi, pi]. Rows in which one side is unknown (a sample withheld, a non-finite fault)
do not count; where no row counts, the metric is None.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from quadftc_flight.diagnosis_metrics.columns import (
    Figure,
    Floats,
    Mask,
    Metrics,
    PerAxis,
    largest,
    mean,
    number,
    rms,
)
from quadftc_flight.diagnosis_metrics.verdicts import diagnosis_metrics
from quadftc_flight.diagnosis_metrics.which_rotor import rotor_metrics
from quadftc_flight.diagnosis_metrics.which_sensor import JudgedSensors, attitude_error, sensor_metrics
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow, events_of_windows
from quadftc_flight.flight import Flight, unknown_flight
from quadftc_model.hints import nearest
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | bool | None"

SETTLING_TIME = 0.2  # s; how long after an onset or an end the estimate may be off
LOST = math.radians(60.0)  # rad; a vehicle that is tilted or off so far is lost
SETTLED_ERROR_DEG = 0.05  # deg; the estimate has settled when its error stays below


def flight_metrics(
    flight: Flight,
    windows: Sequence[FaultWindow],
    events: Sequence[FaultEvent] | None = None,
    rotor_events: Sequence[FaultEvent] = (),
) -> Metrics:
    """Compute every metric, ready for JSON; ``windows`` divide the time into inside and outside a fault.

    ``events`` are the faults that the diagnosis is judged by; default: those of the windows. In free flight
    it is judged by those of rotors, too.
    """
    time = flight.time
    tracking = np.degrees(wrap(flight.angles - flight.reference))
    estimate = np.degrees(wrap(flight.fault_estimate - flight.fault))
    # when a fault acts, and when the estimate has had time to settle since one began or ended
    inside = _within(time, windows)
    moments = {moment for window in windows for moment in (window.start, window.stop)}
    tilt, error = _tilt(flight.angles), attitude_error(flight)
    judged = JudgedSensors(flight, events or ())
    rotors = {"rotors": rotor_metrics(flight, rotor_events, judged)} if flight.rotor_state.shape[1] else {}
    settled = ~_within(time, (FaultWindow(moment, moment + SETTLING_TIME, ()) for moment in moments))
    return {
        "tracking_rmse_deg": _per_axis(rms, tracking),
        "tracking_max_deg": _per_axis(largest, tracking),
        "fault_max_deg": _per_axis(largest, np.degrees(flight.fault)),
        "fault_estimate_rmse_deg": _per_axis(rms, estimate),
        "fault_estimate_max_deg": _per_axis(largest, estimate),
        "fault_estimate_rmse_inside_deg": _per_axis(rms, estimate[inside]),
        "fault_estimate_max_inside_deg": _per_axis(largest, estimate[inside]),
        "fault_estimate_rmse_outside_deg": _per_axis(rms, estimate[~inside]),
        "fault_estimate_max_outside_deg": _per_axis(largest, estimate[~inside]),
        "fault_estimate_max_settled_deg": _per_axis(largest, estimate[settled]),
        "fault_windows": [_window(window, time, tracking, estimate) for window in windows],
        "disturbance_estimate_rmse": _per_axis(rms, flight.disturbance_estimate - flight.disturbance),
        **_effort(flight),
        "position_rmse_m": rms(_distance(flight.position, flight.position_reference)),
        "position_max_m": largest(_distance(flight.position, flight.position_reference)),
        "position_estimate_rmse_m": rms(_distance(flight.position_estimate, flight.position)),
        "max_tilt_deg": largest(np.degrees(tilt)),
        "attitude_error_rms_deg": rms(error),
        "attitude_error_max_deg": largest(error),
        "lost": bool(np.any(lost_rows(flight))),
        "diagnosis": diagnosis_metrics(flight, events_of_windows(windows) if events is None else events),
        "sensors": sensor_metrics(flight, events or (), judged),
        **rotors,
    }


def known_metrics(
    window_count: int,
    events: Sequence[FaultEvent] = (),
    rotor_events: Sequence[FaultEvent] = (),
    rotors: int = 0,
) -> Metrics:
    """Return the metrics of a flight with that many fault windows and these events, for their names.

    In free flight it has so many ``rotors``.
    """
    windows = [FaultWindow(0.0, 1.0, AXES)] * window_count
    return flight_metrics(flight_of_nothing(rotors), windows, events, rotor_events)


def flight_of_nothing(rotors: int = 0) -> Flight:
    """Return a flight of two samples that knows nothing, for the names of what is computed of it."""
    return dataclasses.replace(unknown_flight(np.arange(2), rotors), time=np.array([-2.0, -1.0]))


def look_up(metrics: Json, path: str) -> Json:
    """Return the metric of a dotted path, such as ``fault_windows.0.tracking_mean_deg.roll``, or KeyError."""
    place = metrics
    for word in path.split("."):
        names = dict(entries(place))
        if word not in names:
            close = nearest(word, names)
            there = close or f"; there is: {', '.join(names) or 'nothing more'}"
            raise KeyError(f"no metric '{path}': no '{word}'{there}")
        place = names[word]
    return place


def entries(place: Json) -> Iterator[tuple[str, Json]]:
    """Yield the words that a path may go on with, and what they lead to."""
    if isinstance(place, dict):
        yield from place.items()
    elif isinstance(place, list):
        yield from ((str(index), item) for index, item in enumerate(place))


def _tilt(angles: Floats) -> Floats:
    """Angle between the body's z axis and the vertical [rad] (n,)."""
    return np.arccos(np.clip(np.cos(angles[:, 0]) * np.cos(angles[:, 1]), -1.0, 1.0))


def _distance(place: Floats, other: Floats) -> Floats:
    """Distance of two places [m] (n,)."""
    return np.linalg.norm(place - other, axis=1)


def lost_rows(flight: Flight) -> Mask:
    """Where (n,) the vehicle tilts by `LOST` and its reference does not, or an angle is off by that."""
    tilted = (_tilt(flight.angles) > LOST) & ~(_tilt(flight.reference) > LOST)
    off = np.abs(wrap(flight.angles - flight.reference)) > LOST
    return np.asarray(tilted | np.any(off, axis=1), np.bool_)


def _window(window: FaultWindow, time: Floats, tracking: Floats, estimate: Floats) -> Metrics:
    rows = _within(time, [window])
    return {
        "start": window.start,
        "stop": window.stop,
        "axes": list(window.axes),
        "tracking_mean_deg": _per_axis(mean, tracking[rows]),
        "tracking_rmse_deg": _per_axis(rms, tracking[rows]),
        "tracking_max_deg": _per_axis(largest, tracking[rows]),
        "fault_estimate_rmse_deg": _per_axis(rms, estimate[rows]),
        "fault_estimate_max_deg": _per_axis(largest, estimate[rows]),
        "fault_estimate_settling_s": {
            name: _settling(time[rows] - window.start, estimate[rows, axis]) for axis, name in enumerate(AXES)
        },
    }


def _effort(flight: Flight) -> Metrics:
    """Torque: root mean square [N m], total variation a second (chattering) [N m/s], share of cut samples."""
    known = np.all(np.isfinite(flight.torque), axis=1)
    torque = flight.torque[known]
    duration = float(flight.time[-1] - flight.time[0]) if len(flight) else 0.0
    is_long = len(torque) and duration > 0.0
    variation = np.sum(np.abs(np.diff(torque, axis=0)), axis=0) / duration if is_long else [None] * 3
    return {
        "torque_rms": _per_axis(rms, torque),
        "torque_total_variation": dict(zip(AXES, map(number, variation), strict=True)),
        "saturation_share": _per_axis(mean, flight.saturated[known].astype(np.float64)),
    }


def _settling(elapsed: Float[Floats, " n"], error_deg: Float[Floats, " n"]) -> float | None:
    """Time since the onset [s] from which the error stays small until the window's end; None: never."""
    known = np.isfinite(error_deg)
    moments, large = elapsed[known], np.abs(error_deg[known]) >= SETTLED_ERROR_DEG
    last_large = int(np.flatnonzero(large)[-1]) if large.any() else -1
    return float(moments[last_large + 1]) if last_large + 1 < len(moments) else None


def _within(time: Float[Floats, " n"], windows: Iterable[FaultWindow]) -> Bool[Mask, " n"]:
    mask = np.zeros(len(time), np.bool_)
    for start, stop, _ in windows:
        mask |= (start <= time) & (time < stop)
    return mask


def _per_axis(figure: Figure, values: Floats) -> PerAxis:
    return {name: figure(values[:, axis]) for axis, name in enumerate(AXES)}
