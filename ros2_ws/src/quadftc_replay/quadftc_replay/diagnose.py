"""A recording through the diagnosis, sample by sample, as the graph does it; nothing of ROS is in between."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_flight.flight import NO_STATE, Flight, onset_ns, unknown_flight
from quadftc_flight.reported import note_reports
from quadftc_model.rotations import wrap
from quadftc_model.samples import DiagnosisReport, FaultEstimate, ImuSample
from quadftc_replay.imu_recording import Floats, Recording
from quadftc_sim.injection import TRUTH
from quadftc_sim.injector import FaultInjector, Faulty

Progress = Callable[[float], None]  # called with the share of the samples that are done
STRIDE = 256  # samples between two calls


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosed:
    """What became of each sample; in the rows of withheld samples all is NaN, zero or absent."""

    delivered: NDArray[np.bool_]  # (n,) False: an overlaid fault withheld the sample
    seen: ImuSample  # what the observer saw: the samples with the overlaid faults; leading axis n
    overlaid: dict[str, Floats]  # channel to the overlaid fault (n, 3), of withheld samples too
    estimate: FaultEstimate  # leading axis n; what is said of other sensors is in the reports
    reports: list[DiagnosisReport]  # those that the node would publish
    unusable: int  # samples with an estimate that could not be used; the observer restarted after each


_UNKNOWN = np.full(3, np.nan)
UNSEEN = ImuSample(np.zeros(4), np.zeros(3), np.zeros(3), np.False_, np.False_, np.False_)
UNSAID = FaultEstimate(_UNKNOWN, _UNKNOWN, np.full(3, NO_STATE, np.uint8), _UNKNOWN, UNSEEN)


def diagnose(
    recording: Recording, law: FaultObserver, injector: FaultInjector, progress: Progress | None = None
) -> Diagnosed:
    """Put the faults of an injector, which is used up, on the samples, and diagnose them."""
    diagnosis, injected, estimates = Diagnosis(law), list[Faulty](), list[FaultEstimate]()
    reports = list[DiagnosisReport]()
    for row, stamp_ns in enumerate(recording.stamp_ns.tolist()):
        faulty = injector.apply(stamp_ns, ImuSample(*(column[row] for column in recording.imu)))
        estimate = None
        if faulty.present:
            torque = recording.torque[row] if recording.driven else None
            estimate = diagnosis.diagnose(stamp_ns, faulty.sample, torque)
            assert estimate is not None  # stamps increase
            reports += filter(None, [diagnosis.report(stamp_ns, estimate)])
        injected.append(faulty)
        estimates.append(estimate or UNSAID)
        if progress is not None and row % STRIDE == 0:
            progress(row / len(recording))
    *said, corrected, _, _ = zip(*estimates, strict=True)
    return Diagnosed(
        delivered=np.array([each.present for each in injected], np.bool_),
        seen=_stack([each.sample if each.present else UNSEEN for each in injected]),
        overlaid={channel: np.stack([getattr(each, channel) for each in injected]) for channel in TRUTH},
        estimate=FaultEstimate._make([*map(np.stack, said), _stack(corrected), None, None]),
        reports=reports,
        unusable=diagnosis.replaced,
    )


def _stack(samples: Sequence[ImuSample]) -> ImuSample:
    return ImuSample(*(np.stack(column) for column in zip(*samples, strict=True)))


def flight_of(recording: Recording, diagnosed: Diagnosed) -> Flight:
    """Return the replayed flight: time, the true fault and what the observer said; all else is unknown."""
    rows, said, flight = diagnosed.delivered, diagnosed.estimate, unknown_flight(recording.stamp_ns)
    flight.delivered[:] = rows
    flight.fault[rows] = true_fault(recording, diagnosed, "attitude")[rows]
    for channel, column in (("gyro", flight.gyro_fault), ("accelerometer", flight.accelerometer_fault)):
        if channel in recording.faults or np.any(diagnosed.overlaid[channel]):
            column[rows] = true_fault(recording, diagnosed, channel)[rows]
    flight.fault_estimate[:], flight.fault_std_dev[:], flight.fault_state[:] = said[:3]
    flight.fault_onset_ns[:] = onset_ns(recording.stamp_ns[:, None], said.onset_age)
    note_reports(flight, diagnosed.reports)
    return flight


def true_fault(recording: Recording, diagnosed: Diagnosed, channel: str) -> Floats:
    """Recorded and overlaid fault of a channel together (n, 3), angles wrapped; NaN where not known."""
    overlaid = diagnosed.overlaid[channel]
    if channel not in recording.faults:
        return overlaid
    total = recording.faults[channel] + overlaid
    return wrap(total) if channel == "attitude" else total
