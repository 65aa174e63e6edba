"""The recording of an IMU from a flight log of any format that `readers` knows, by its signals.

The gyro drives the diagnosis and gives the stamps. Each attitude belongs to the gyro sample nearest in time,
and is carried there by the body rate; the samples between have none, which observers bridge. Of the
accelerometer of the same name the latest reading counts. Torque is known where it is logged in N m.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quadftc_bags.bag import BagError
from quadftc_model.samples import ImuSample
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_replay.flight_log import MAIN, FlightLog, Signal
from quadftc_replay.imu_recording import Recording, Stamps, carried_attitudes, clean_samples, torque_before
from quadftc_replay.readers import ONLY_ONE, LogChoice
from quadftc_replay.readers.bounded import read_bounded


def recording_from_log(path: Path, topic: str = "", choice: LogChoice = ONLY_ONE) -> Recording:
    """Read the attitude and a gyro of a log; BagError if one of them is not there.

    ``topic`` is the name of one of several gyros, such as ``1``; empty: the main one. Samples whose stamp
    goes back are left out; a warning says so.
    """
    return recording_of(read_bounded(path, choice), topic)


def recording_of(log: FlightLog, topic: str = "") -> Recording:
    """Return the attitude and a gyro of a log that is read already, as `recording_from_log`."""
    path, (name, gyro) = log.path, _gyro(log, topic)
    if not log.attitude:  # or no sample of it
        reason = "a diagnosis compares attitude and gyro, of which there is only the gyro"
        raise BagError(f"{path}: no attitude in this {log.format} log; {reason}")
    stamp_ns, rate = _stamps(log, gyro), gyro.value
    q_xyzw, attitude_valid = carried_attitudes(stamp_ns, rate, _stamps(log, log.attitude), log.attitude.value)
    force, force_valid = np.zeros_like(rate), np.zeros(len(rate), np.bool_)
    if (sensor := log.accelerometers.get(topic)) is not None:
        last = np.searchsorted(_stamps(log, sensor), stamp_ns, side="right") - 1
        force_valid = last >= 0
        force = np.where(force_valid[:, None], sensor.value[last], 0.0)
    torque, commands = np.zeros_like(rate), log.torque_command
    is_torque = commands is not None and log.torque_unit == "N m"
    if commands is not None and is_torque:
        torque = torque_before(stamp_ns, _stamps(log, commands), commands.value)
    imu = ImuSample(q_xyzw, rate, force, attitude_valid, np.ones(len(rate), np.bool_), force_valid)
    where = f"{path}: {name}"
    samples, absences = clean_samples(imu, stamp_ns, where)
    return Recording(
        name=path.stem,
        path=path,
        topic=name,
        namespace="/",
        stamp_ns=stamp_ns,
        imu=samples,
        torque=torque,
        torque_topic="torque command" if is_torque else None,
        torque_is_command=is_torque,
        attitude_from_gyro=bool(log.attitude_from_gyro),
        vehicle=log.vehicle,
        warnings=(*(f"{path}: {note}" for note in log.notes), *absences),
    )


def _gyro(log: FlightLog, topic: str) -> tuple[str, Signal]:
    if topic not in log.gyros:
        named = [f"'{name}'" for name in log.gyros if name != MAIN]
        there = ", ".join(["the main one"] * (MAIN in log.gyros) + named) or "none"
        problem = f"no gyro '{topic}'" if topic else "no gyro"
        raise BagError(f"{log.path}: {problem} in this {log.format} log; gyros there: {there}")
    return f"gyro {topic}".strip(), log.gyros[topic]


def _stamps(log: FlightLog, signal: Signal) -> Stamps:
    """Stamps of a signal on the clock of the log [ns]."""
    return log.start_ns + np.rint(signal.time * NANOSECONDS_PER_SECOND).astype(np.int64)
