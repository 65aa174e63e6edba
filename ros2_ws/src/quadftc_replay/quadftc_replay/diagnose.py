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
from quadftc_replay.recording import Floats, Recording
from quadftc_sim.injector import FaultInjector, Injected

Progress = Callable[[float], None]  # called with the share of the samples that are done
STRIDE = 256  # samples between two calls

CHANNELS = ("attitude", "gyro", "accelerometer")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosed:
    """What became of each sample of a recording; in the rows of withheld samples all is NaN, zero or absent.

    Parameters
    ----------
    delivered : array (n,)
        False: an overlaid fault withheld the sample.
    seen : ImuSample
        What the observer saw: the samples with the overlaid faults; leading axis n.
    overlaid : mapping
        Channel to the overlaid fault (n, 3), of withheld samples too.
    fault, std_dev, state, onset_age : array (n, 3)
        As in `FaultEstimate`.
    corrected : ImuSample
        Leading axis n.
    no_number : int
        Samples with an estimate that could not be used; the observer restarted after each.
    """

    delivered: NDArray[np.bool_]
    seen: ImuSample
    overlaid: dict[str, Floats]
    fault: Floats
    std_dev: Floats
    state: NDArray[np.uint8]
    onset_age: Floats
    corrected: ImuSample
    no_number: int


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
    diagnosis = Diagnosis(law)
    log = _Log(len(recording))
    stamps = recording.stamp_ns.tolist()
    for row, stamp_ns in enumerate(stamps):
        injected = injector.apply(stamp_ns, _row_of(recording.imu, row))
        log.injected(row, injected)
        if injected.sample is not None:
            estimate = diagnosis.step(stamp_ns, injected.sample, recording.torque[row])
            assert estimate is not None  # stamps increase
            log.estimate(row, estimate)
        if progress is not None and row % STRIDE == 0:
            progress(row / len(stamps))
    return log.diagnosed(diagnosis.replaced)


def flight_of(recording: Recording, diagnosed: Diagnosed) -> Flight:
    """Return the replayed flight: time, the true fault and what the observer said; all else is unknown."""
    rows = diagnosed.delivered
    unknown = np.full((len(recording), 3), np.nan)
    columns = dict.fromkeys(VECTORS, unknown)
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


class _Log:
    """Rows of what came out, while the samples go through."""

    def __init__(self, count: int) -> None:
        self._delivered = np.zeros(count, np.bool_)
        self._overlaid = {channel: np.zeros((count, 3)) for channel in CHANNELS}
        self._seen, self._corrected = _no_samples(count), _no_samples(count)
        self._fault, self._std_dev, self._age = (np.full((count, 3), np.nan) for _ in range(3))
        self._state = np.full((count, 3), NO_STATE, np.uint8)

    def injected(self, row: int, injected: Injected) -> None:
        self._delivered[row] = injected.sample is not None
        for channel in CHANNELS:
            self._overlaid[channel][row] = getattr(injected, channel)
        if injected.sample is not None:
            _set_row(self._seen, row, injected.sample)

    def estimate(self, row: int, estimate: FaultEstimate) -> None:
        self._fault[row], self._std_dev[row] = estimate.fault, estimate.std_dev
        self._state[row], self._age[row] = estimate.state, estimate.onset_age
        _set_row(self._corrected, row, estimate.corrected)

    def diagnosed(self, no_number: int) -> Diagnosed:
        return Diagnosed(
            delivered=self._delivered,
            seen=self._seen,
            overlaid=self._overlaid,
            fault=self._fault,
            std_dev=self._std_dev,
            state=self._state,
            onset_age=self._age,
            corrected=self._corrected,
            no_number=no_number,
        )


def _no_samples(count: int) -> ImuSample:
    missing = [np.zeros(count, np.bool_) for _ in range(3)]
    return ImuSample(np.zeros((count, 4)), np.zeros((count, 3)), np.zeros((count, 3)), *missing)


def _row_of(samples: ImuSample, row: int) -> ImuSample:
    return ImuSample(*(column[row] for column in samples))


def _set_row(samples: ImuSample, row: int, sample: ImuSample) -> None:
    for column, value in zip(samples, sample, strict=True):
        column[row] = value
