# pyright: basic
"""The recording of an IMU from a PX4 log (ULog).

| in the log | in the sample |
|---|---|
| ``sensor_combined.gyro_rad``, else ``vehicle_angular_velocity.xyz`` | body rate; gives the stamps |
| ``vehicle_attitude.q`` | attitude |
| ``sensor_combined.accelerometer_m_s2``, else ``vehicle_acceleration.xyz`` | specific force |

The gyro drives the diagnosis, as in an IMU: PX4 logs it at 100-250 Hz by default, and the attitude at 20 Hz.
Each attitude belongs to the gyro sample nearest in time, and is carried there, over less than one period of
the gyro, by the body rate; the samples between have none (``orientation_covariance[0] = -1`` in a message),
which observers bridge. Of attitudes faster than the gyro, the nearest are taken.

Stamps are those of the sensor sample (``timestamp_sample`` where there is one), since the system's start. The
log has torques only without a unit, so the torque is zero. The attitude is PX4's own estimate, to which this
gyro has contributed; where its estimator resets it, it jumps, and a warning says when.

PX4's frames are north-east-down and forward-right-down; `quadftc_model.frames` turns them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_model.frames import enu_flu_from_ned_frd, flu_from_frd
from quadftc_model.samples import ImuSample
from quadftc_replay.imu_recording import (
    Floats,
    Recording,
    Stamps,
    carried_attitudes,
    clean_samples,
    keep_good_stamps,
    latest_rows,
)
from quadftc_replay.readers.ulog import ATTITUDE, FORCES, GYROS, INVALID_TIME, read_contents, resets
from quadftc_replay.readers.ulog_datasets import Dataset, stamps_of, vectors


def is_ulog(path: Path) -> bool:
    """Whether a file is meant as a PX4 log, by its name."""
    return path.suffix.lower() in (".ulg", ".ulog") and not path.is_dir()


def recording_from_ulog(path: Path, topic: str = "", skip_backwards: bool = False) -> Recording:
    """Read the attitude and the gyro of a PX4 log, as `recording_from_bag` reads a bag.

    ``topic`` is that of the gyro; empty: the first of `GYROS` that is there.
    """
    log = read_contents(path, (ATTITUDE, *GYROS, *FORCES))
    data = {name: table for (name, instance), table in log.data.items() if instance == 0}
    name = _gyro_topic(data, topic, path)
    gyro, where = data[name], f"{path}: {name}"
    kept = keep_good_stamps(stamps_of(gyro), None, where, skip_backwards)
    rate = flu_from_frd(_columns(gyro, GYROS[name], 3, where)[kept.rows])
    attitude = enu_flu_from_ned_frd(_columns(data[ATTITUDE], "q", 4, f"{path}: {ATTITUDE}"))
    q_xyzw, attitude_valid = carried_attitudes(kept.stamp_ns, rate, stamps_of(data[ATTITUDE]), attitude)
    force, force_valid = _forces(data, kept.stamp_ns, path)
    imu = ImuSample(q_xyzw, rate, force, attitude_valid, np.ones(len(rate), np.bool_), force_valid)
    samples, absences = clean_samples(imu, kept.stamp_ns, where)
    damage = [f"{path}: damaged; read what makes sense"] if log.corrupt else []
    jumps = [f"{path}: {note}" for note in resets(data[ATTITUDE], int(kept.stamp_ns[0]))]
    return Recording(
        name=path.stem,
        path=path,
        topic=name,
        namespace="/",
        stamp_ns=kept.stamp_ns,
        imu=samples,
        torque=np.zeros((len(rate), 3)),
        attitude_from_gyro=True,
        rejected=kept.rejected,
        warnings=(*damage, *(f"{path}: {note}" for note in log.notes), *kept.warnings, *absences, *jumps),
    )


def _gyro_topic(data: Mapping[str, Dataset], wanted: str, path: Path) -> str:
    if wanted and wanted not in GYROS:
        raise BagError(f"{path}: topic '{wanted}': of a PX4 log, expected one of {', '.join(GYROS)}")
    names = [wanted] if wanted else list(GYROS)
    there = [name for name in names if name in data]
    missing = [ATTITUDE] * (ATTITUDE not in data) + [" or ".join(names)] * (not there)
    if missing:
        known = f"of the topics that count there are: {', '.join(data) or 'none'}"
        raise BagError(f"{path}: no data of {' and '.join(missing)}; {known}")
    return there[0]


def _columns(data: Dataset, field: str, width: int, where: str) -> Floats:
    """Field with ``width`` elements (n, width)."""
    value = vectors(data, field, width)
    if value is None:
        raise BagError(f"{where}: no field '{field}' of {width} elements; fields: {', '.join(data)}")
    return value


def _forces(data: Mapping[str, Dataset], stamp_ns: Stamps, path: Path) -> tuple[Floats, NDArray[np.bool_]]:
    """Specific force of each sample (n, 3): the latest that was measured; and where there is one (n,)."""
    name = next((name for name in FORCES if name in data), None)
    if name is None:
        return np.zeros((len(stamp_ns), 3)), np.zeros(len(stamp_ns), np.bool_)
    force = flu_from_frd(_columns(data[name], FORCES[name], 3, f"{path}: {name}"))
    last = latest_rows(stamp_ns, stamps_of(data[name]))
    valid = last >= 0
    relative = data[name].get("accelerometer_timestamp_relative")
    if relative is not None:
        valid &= relative[last] != INVALID_TIME
    return np.where(valid[:, None], force[last], 0.0), valid
