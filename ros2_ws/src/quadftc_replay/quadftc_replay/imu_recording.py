"""The samples of an IMU from a bag or a log as arrays on their own clock, and the clean-up that all get.

What is missing in a sample is marked as absent; nothing is filled in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow
from quadftc_model.rotations import quaternion_from_rotation_vector, quaternion_product
from quadftc_model.samples import ImuSample, sanitised
from quadftc_model.stepper import MAX_GAP, NANOSECONDS_PER_SECOND

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]


class SerializedTopic(NamedTuple):
    """Messages as they stand in a bag."""

    stamp_ns: Stamps  # (n,)
    messages: list[bytes]  # n


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """The samples of one IMU in the order of their stamps, and what is known beside them."""

    name: str  # of the bag or log
    path: Path
    topic: str  # full name of that of the samples
    namespace: str  # of the vehicle, with its slashes: ``/`` or ``/name/``
    stamp_ns: Stamps  # (n,) strictly increasing [ns]
    imu: ImuSample  # leading axis n; what cannot be used is marked as absent
    torque: Floats  # (n, 3) that acted since the sample before [N m]; zero where none was recorded
    torque_topic: str | None = None
    torque_is_command: bool = False  # of real rotors, which follow it by their lag
    attitude_from_gyro: bool = False  # the attitude is computed from this gyro
    vehicle: str = ""  # name of its file, if the recording tells it
    # channel to the recorded true fault (n, 3); NaN where it is unknown, no entry where it is not recorded
    faults: Mapping[str, Floats] = field(default_factory=dict[str, Floats])
    fault_windows: tuple[FaultWindow, ...] = ()  # when the attitude is faulty by what was recorded
    fault_events: tuple[FaultEvent, ...] = ()  # the same axis by axis, with the kind of fault
    # parameters of the node that diagnosed these samples first; empty: not known; None: they make no sense
    observer: Mapping[str, object] | None = field(default_factory=dict[str, object])
    # topic, relative to the namespace, to what goes into the new bag as it is
    passed_on: Mapping[str, SerializedTopic] = field(default_factory=dict[str, SerializedTopic])
    rejected: Mapping[str, int] = field(default_factory=dict[str, int])  # reason to samples left out
    warnings: tuple[str, ...] = ()  # one line each

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def driven(self) -> bool:
        """Whether the torque is known."""
        return self.torque_topic is not None

    @property
    def duration(self) -> float:
        """Time from the first sample to the end of the last sample's period [s]."""
        span_ns = int(self.stamp_ns[-1] - self.stamp_ns[0])
        return span_ns / NANOSECONDS_PER_SECOND + 1.0 / sampling_rate(self.stamp_ns)


def sampling_rate(stamp_ns: Stamps) -> float:
    """One over the median time between two samples [Hz]."""
    return NANOSECONDS_PER_SECOND / float(np.median(np.diff(stamp_ns)))


class KeptSamples(NamedTuple):
    """The samples of a recording that have a good stamp, and warnings about the others."""

    rows: NDArray[np.intp]  # which of the recorded samples
    stamp_ns: Stamps  # strictly increasing
    rejected: dict[str, int]  # reason to samples left out
    warnings: list[str]


def keep_good_stamps(
    stamp_ns: Stamps, log_time_ns: Stamps | None, where: str, skip_backwards: bool
) -> KeptSamples:
    """Leave out samples whose stamp is not set, is repeated or (if asked, as the graph does) goes back.

    Both times (n,) are in the order of recording. Where no stamp is set at all, the time of recording takes
    its place, if there is one. Errors begin with ``where``, the file and topic.
    """
    warnings: list[str] = []
    if log_time_ns is not None and not np.any(stamp_ns):
        warnings.append(f"{where}: no stamp is set; the time of recording took their place")
        stamp_ns = log_time_ns
    # zero is no stamp, unless the clock plainly began there
    others = stamp_ns[stamp_ns != 0]
    began = len(others) and others.min() <= MAX_GAP * NANOSECONDS_PER_SECOND
    rows = np.flatnonzero((stamp_ns != 0) | bool(began))
    stamps = stamp_ns[rows]
    before = np.maximum.accumulate(np.concatenate([[np.iinfo(np.int64).min], stamps]))[:-1]
    back = stamps < before
    if back.any() and not skip_backwards:
        raise BagError(f"{where}: {_first_step_back(stamps, rows)}")
    counts = {
        "stamp not set": len(stamp_ns) - len(rows),
        "stamp went back": int(back.sum()),
        "stamp repeated": int((stamps == before).sum()),
    }
    rows, stamps = rows[stamps > before], stamps[stamps > before]
    if len(rows) < 2:
        raise BagError(f"{where}: {len(rows)} samples with a good stamp; expected at least 2")
    rejected = {reason: count for reason, count in counts.items() if count}
    if rejected:
        reasons = ", ".join(f"{reason}: {count}" for reason, count in rejected.items())
        total = sum(rejected.values())
        warnings.append(f"{where}: {total} of {len(stamp_ns)} samples left out ({reasons})")
    return KeptSamples(rows, stamps, rejected, warnings)


def clean_samples(imu: ImuSample, stamp_ns: Stamps, where: str) -> tuple[ImuSample, list[str]]:
    """Mark as absent what cannot be used; return the samples and warnings about absences and gaps.

    If no sample has both attitude and body rate, BagError is raised.
    """
    clean = sanitised(imu)
    warnings: list[str] = []
    for words, wrong, given, valid in (
        ("attitude", "zero, not of unit length or not finite", imu.attitude_valid, clean.attitude_valid),
        ("body rate", "not finite", imu.rate_valid, clean.rate_valid),
    ):
        absent, unusable = int((~given).sum()), int((given & ~valid).sum())
        details = f"{absent} marked absent, {unusable} {wrong}"
        if not valid.any():
            raise BagError(f"{where}: no sample has a usable {words} ({details}); a diagnosis needs both")
        if not valid.all():
            count = f"{absent + unusable} of {len(valid)}"
            warnings.append(f"{where}: {count} samples without {words} ({details}); bridged")
    if not np.any(clean.attitude_valid & clean.rate_valid):
        raise BagError(f"{where}: no sample has both attitude and body rate; a diagnosis needs both to start")
    if gaps := int(np.sum(np.diff(stamp_ns) > MAX_GAP * NANOSECONDS_PER_SECOND)):
        long = f"gaps of more than {MAX_GAP:g} s: {gaps}"
        warnings.append(f"{where}: {long}; the diagnosis restarts after each")
    return clean, warnings


def carried_attitudes(
    stamp_ns: Stamps, rate: Floats, attitude_ns: Stamps, attitude: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Attitude of each gyro sample (n, 4), and where there is one (n,).

    Each attitude belongs to the gyro sample nearest in time, and is carried there by the body rate (n, 3).
    """
    chosen = nearest_rows(stamp_ns, attitude_ns)
    there = chosen >= 0
    elapsed = np.where(there, stamp_ns - attitude_ns[chosen], 0) / NANOSECONDS_PER_SECOND
    turn = quaternion_from_rotation_vector(np.nan_to_num(rate) * elapsed[:, None])
    return np.where(there[:, None], quaternion_product(attitude[chosen], turn), 0.0), there


def nearest_rows(stamp_ns: Stamps, others_ns: Stamps) -> NDArray[np.intp]:
    """For each stamp, the row of the other stamp that belongs to it; -1: none.

    Each of the others belongs to the stamp nearest to it, if that is less than a median period away; of
    several that belong to one stamp, the nearest is taken.
    """
    after = np.clip(np.searchsorted(stamp_ns, others_ns), 1, len(stamp_ns) - 1)
    is_earlier = others_ns - stamp_ns[after - 1] <= stamp_ns[after] - others_ns
    nearest = np.where(is_earlier, after - 1, after)
    distance = np.abs(stamp_ns[nearest] - others_ns)
    near = np.flatnonzero(distance < np.median(np.diff(stamp_ns)))
    order = near[np.argsort(-distance[near], kind="stable")]  # the nearest comes last, and stays
    rows = np.full(len(stamp_ns), -1)
    rows[nearest[order]] = order
    return rows


def torque_before(stamp_ns: Stamps, command_ns: Stamps, command: Floats) -> Floats:
    """Torque that acted before each sample (n, 3): the last finite command with an earlier stamp, else zero.

    In a recording of the graph in lock-step that is the command of the sample before.
    """
    good = np.all(np.isfinite(command), axis=1)
    order = np.argsort(command_ns[good], kind="stable")
    torques = np.vstack([np.zeros(3), command[good][order]])
    return torques[np.searchsorted(command_ns[good][order], stamp_ns, side="left")]


def _first_step_back(stamps: Stamps, rows: NDArray[np.intp]) -> str:
    first, *others = np.flatnonzero(np.diff(stamps) < 0).tolist()
    more = f" (and {len(others)} more times)" if others else ""
    size = (stamps[first] - stamps[first + 1]) / NANOSECONDS_PER_SECOND
    return (
        f"time goes back by {size:.6g} s at message {int(rows[first + 1]) + 1}{more}; expected stamps that"
        " increase; --skip-backwards leaves such samples out, as the graph does"
    )
