"""A recording through the diagnosis, sample by sample, as the graph does it; nothing of ROS is in between."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_flight.flight import NO_STATE, VECTORS, Flight, onset_ns
from quadftc_model.rotations import wrap
from quadftc_model.samples import FaultEstimate, ImuSample
from quadftc_replay.imu_recording import Floats, Recording
from quadftc_sim.injector import FaultInjector

Progress = Callable[[float], None]  # called with the share of the samples that are done
STRIDE = 256  # samples between two calls

CHANNELS = ("attitude", "gyro", "accelerometer")


@dataclasses.dataclass(eq=False, kw_only=True)
class Diagnosed:
    """What became of each sample; in the rows of withheld samples all is NaN, zero or absent."""

    delivered: NDArray[np.bool_]  # (n,) False: an overlaid fault withheld the sample
    seen: ImuSample  # what the observer saw: the samples with the overlaid faults; leading axis n
    overlaid: dict[str, Floats]  # channel to the overlaid fault (n, 3), of withheld samples too
    fault: Floats  # (n, 3), as the next three; see `FaultEstimate`
    std_dev: Floats
    state: NDArray[np.uint8]
    onset_age: Floats
    corrected: ImuSample  # leading axis n
    unusable: int = 0  # samples with an estimate that could not be used; the observer restarted after each


def diagnose(
    recording: Recording, law: FaultObserver, injector: FaultInjector, progress: Progress | None = None
) -> Diagnosed:
    """Put faults on the samples and diagnose them.

    Parameters
    ----------
    recording : Recording
    law : FaultObserver
    injector : FaultInjector
        With the faults to overlay; used up afterwards.
    progress : callable, optional
    """
    diagnosis, result = Diagnosis(law), _blank(len(recording))
    stamps = recording.stamp_ns.tolist()
    for row, stamp_ns in enumerate(stamps):
        # what the fault injector makes of the sample
        injected = injector.apply(stamp_ns, ImuSample(*(column[row] for column in recording.imu)))
        for channel in CHANNELS:
            result.overlaid[channel][row] = getattr(injected, channel)
        # what the observer makes of it, if it is not withheld
        if injected.sample is not None:
            result.delivered[row] = True
            _set_row(result.seen, row, injected.sample)
            estimate = diagnosis.step(stamp_ns, injected.sample, recording.torque[row])
            assert estimate is not None  # stamps increase
            _set_estimate(result, row, estimate)
        if progress is not None and row % STRIDE == 0:
            progress(row / len(stamps))
    result.unusable = diagnosis.replaced
    return result


def flight_of(recording: Recording, diagnosed: Diagnosed) -> Flight:
    """Return the replayed flight: time, the true fault and what the observer said; all else is unknown."""
    rows = diagnosed.delivered
    columns = dict.fromkeys(VECTORS, np.full((len(recording), 3), np.nan))
    columns["fault"] = np.where(rows[:, None], true_fault(recording, diagnosed, "attitude"), np.nan)
    columns["fault_estimate"] = diagnosed.fault
    columns["fault_std_dev"] = diagnosed.std_dev
    return Flight(
        stamp_ns=recording.stamp_ns,
        time=recording.time,
        delivered=rows,
        fault_state=np.where(rows[:, None], diagnosed.state, np.uint8(NO_STATE)),
        fault_onset_ns=onset_ns(recording.stamp_ns[:, None], diagnosed.onset_age),
        saturated=np.zeros((len(recording), 3), np.bool_),
        **columns,
    )


def true_fault(recording: Recording, diagnosed: Diagnosed, channel: str) -> Floats:
    """Recorded and overlaid fault of a channel together (n, 3), angles wrapped; NaN where not known."""
    overlaid = diagnosed.overlaid[channel]
    if channel not in recording.faults:
        return overlaid
    total = recording.faults[channel] + overlaid
    return wrap(total) if channel == "attitude" else total


def _blank(count: int) -> Diagnosed:
    seen, corrected = (
        ImuSample(*(np.zeros((count, n)) for n in (4, 3, 3)), *(np.zeros(count, np.bool_) for _ in range(3)))
        for _ in range(2)
    )
    fault, std_dev, onset_age = (np.full((count, 3), np.nan) for _ in range(3))
    return Diagnosed(
        delivered=np.zeros(count, np.bool_),
        seen=seen,
        overlaid={channel: np.zeros((count, 3)) for channel in CHANNELS},
        fault=fault,
        std_dev=std_dev,
        state=np.full((count, 3), NO_STATE, np.uint8),
        onset_age=onset_age,
        corrected=corrected,
    )


def _set_row(samples: ImuSample, row: int, sample: ImuSample) -> None:
    for column, value in zip(samples, sample, strict=True):
        column[row] = value


def _set_estimate(result: Diagnosed, row: int, estimate: FaultEstimate) -> None:
    result.fault[row], result.std_dev[row] = estimate.fault, estimate.std_dev
    result.state[row], result.onset_age[row] = estimate.state, estimate.onset_age
    _set_row(result.corrected, row, estimate.corrected)
