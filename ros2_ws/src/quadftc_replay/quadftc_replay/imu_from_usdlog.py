"""The recording of an IMU from a Crazyflie's log (uSD card).

`readers.crazyflie` says which variables are what. The event that has the body rate gives the stamps, since
the start of the vehicle; all else is of the same event. The attitude is the vehicle's own estimate, to which
this gyro has contributed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import ImuSample
from quadftc_replay.imu_recording import (
    Floats,
    Recording,
    Stamps,
    clean_samples,
    keep_good_stamps,
    torque_before,
)
from quadftc_replay.readers.crazyflie import ANGLES, FIRST, QUATERNIONS, Source
from quadftc_replay.readers.signals import columns as stack
from quadftc_replay.usdlog import EventRows, read_usdlog

SHOWN = 12  # variables in one line
RATES, FORCES, MOTORS, TORQUES = (
    FIRST[name] for name in ("gyros", "accelerometers", "rotor_commands", "torque_command")
)


class CrazyflieFlight(NamedTuple):
    """What a log tells of a flight, row by row; None: not logged."""

    event: str
    stamp_ns: Stamps  # (n,) strictly increasing
    body_rate: Floats  # (n, 3) [rad/s]
    q_xyzw: Floats | None  # (n, 4) body to earth, as the vehicle estimated it
    specific_force: Floats | None  # (n, 3) [m/s²]
    torque: Floats | None  # (n, 3) commanded at this row [N m]
    motors: Floats | None  # (n, 4) commanded at this row, 0 to 1
    torque_source: str | None
    rejected: Mapping[str, int]  # reason to rows left out
    warnings: tuple[str, ...]


def flight_from_usdlog(path: Path, topic: str = "", skip_backwards: bool = False) -> CrazyflieFlight:
    """Read what a log tells of a flight; ``topic`` is an event, empty: the one with the most body rates.

    A log without a body rate, or one in which stamps go back, is refused by a BagError of one line; of the
    latter ``skip_backwards`` leaves such rows out.
    """
    log = read_usdlog(path)
    event = _choose_event(log.events, topic, path)
    stamp_ns, columns = log.events[event]
    kept = keep_good_stamps(stamp_ns, None, f"{path}: {event}", skip_backwards)

    def take(sources: Sequence[Source]) -> Floats | None:
        source = _find(columns, sources)
        if source is None:
            return None
        return stack({name: columns[name][kept.rows] for name in source.names}, source.names) * source.scale

    rate, q_xyzw, angles, torque = take(RATES), take(QUATERNIONS), take(ANGLES), _find(columns, TORQUES)
    assert rate is not None  # the event was chosen so
    if q_xyzw is None and angles is not None:
        q_xyzw = quaternion_from_euler(angles)
    return CrazyflieFlight(
        event=event,
        stamp_ns=kept.stamp_ns,
        body_rate=rate,
        q_xyzw=q_xyzw,
        specific_force=take(FORCES),
        torque=take(TORQUES),
        motors=take(MOTORS),
        torque_source=f"{event}: {', '.join(torque.names)}" if torque else None,
        rejected=kept.rejected,
        warnings=(*log.warnings, *kept.warnings),
    )


def recording_from_usdlog(path: Path, topic: str = "", skip_backwards: bool = False) -> Recording:
    """Read attitude and gyro of a log, as `recording_from_bag` reads a bag; BagError if one is not there."""
    flight = flight_from_usdlog(path, topic, skip_backwards)
    rate, where = flight.body_rate, f"{path}: {flight.event}"
    if flight.q_xyzw is None:
        wanted = _list_sources((*QUATERNIONS, *ANGLES))
        reason = "a diagnosis compares attitude and gyro, of which there is only the gyro"
        raise BagError(f"{where}: no attitude was logged; expected {wanted}; {reason}")
    there = np.ones(len(rate), np.bool_)
    has_force = flight.specific_force is not None
    force = flight.specific_force if flight.specific_force is not None else np.zeros_like(rate)
    imu = ImuSample(flight.q_xyzw, rate, force, there, there, there & has_force)
    samples, absences = clean_samples(imu, flight.stamp_ns, where)
    torque = np.zeros_like(rate)
    if flight.torque is not None:
        torque = torque_before(flight.stamp_ns, flight.stamp_ns, flight.torque)
    return Recording(
        name=path.name,
        path=path,
        topic=flight.event,
        namespace="/",
        stamp_ns=flight.stamp_ns,
        imu=samples,
        torque=torque,
        torque_topic=flight.torque_source,
        attitude_from_gyro=True,
        rejected=flight.rejected,
        warnings=(*flight.warnings, *absences),
    )


def _choose_event(events: Mapping[str, EventRows], wanted: str, path: Path) -> str:
    """Return the event to read: the one wanted, or of those with a body rate the one with the most rows."""
    if wanted and wanted not in events:
        raise BagError(f"{path}: no event '{wanted}'; events there: {', '.join(events)}")
    names = [wanted] if wanted else list(events)
    fit = [name for name in names if _find(events[name].columns, RATES)]
    if not fit:
        there = "; ".join(f"{name}: {_list(list(events[name].columns))}" for name in names)
        raise BagError(f"{path}: no body rate; expected {_list_sources(RATES)}; variables there: {there}")
    chosen = max(fit, key=lambda name: len(events[name].stamp_ns))
    if not len(events[chosen].stamp_ns):
        raise BagError(f"{path}: no row of {' or '.join(fit)}")
    return chosen


def _find(columns: Mapping[str, NDArray[Any]], sources: Sequence[Source]) -> Source | None:
    return next((source for source in sources if all(name in columns for name in source.names)), None)


def _list_sources(sources: Sequence[Source]) -> str:
    return " or ".join(", ".join(source.names) for source in sources)


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (", ".join(names[:SHOWN]) or "none") + more
