"""A recording through the diagnosis, as the graph does it; nothing of ROS is in between."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from quadftc_compile.engine import engine_named
from quadftc_compile.wiring import BLOCK, flown_by
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_flight.flight import NO_STATE, Flight, onset_ns, unknown_flight
from quadftc_flight.reported import ReportLog, joined, note_reports
from quadftc_model.arrays import AnyArray, chosen, rows_of
from quadftc_model.rotations import wrap
from quadftc_model.samples import DiagnosisReport, FaultEstimate, ImuSample
from quadftc_replay.imu_recording import Floats, Recording
from quadftc_replay.open_loop import OpenDraws, open_loop_of
from quadftc_sim.injection import TRUTH, Injection

Progress = Callable[[float], None]  # called with the share of the samples that are done


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
    recording: Recording,
    law: FaultObserver,
    injections: Sequence[Injection] = (),
    seed: int = 0,
    engine: str = "c",
    progress: Progress | None = None,
) -> Diagnosed:
    """Put faults on the samples, and diagnose them; ``seed`` is that of random faults.

    ``engine`` runs the laws: "c", or "numpy", the reference.
    """
    loop, count = open_loop_of(recording, law, injections), len(recording)
    draws = OpenDraws(recording, loop.injections, seed)
    flown = flown_by(engine_named(engine), loop, draws.example())
    reports, parts, unusable = ReportLog(law), list[tuple[AnyArray, ...]](), 0
    for begin in range(0, count, BLOCK):
        stop = min(begin + BLOCK, count)
        output = flown.run(draws.rows(begin, stop), stop - begin)
        faulty, estimate, came = output.faulty, output.estimate.said, output.faulty.present
        reports.note(recording.stamp_ns[begin:stop][came], rows_of(estimate, came))
        unusable += int(np.sum(output.estimate.failed & came))
        seen = chosen(came, faulty.sample, UNSEEN)
        overlaid = tuple(getattr(faulty, channel) for channel in TRUTH)
        said = chosen(came, estimate._replace(sensors=None, rotors=None), UNSAID)
        parts.append(joined([(came, seen, overlaid, said)]))  # a copy: the next block takes its place
        if progress is not None:
            progress(stop / count)
    delivered, seen, overlaid, estimate = joined(parts)
    return Diagnosed(
        delivered=delivered,
        seen=seen,
        overlaid=dict(zip(TRUTH, overlaid, strict=True)),
        estimate=estimate,
        reports=reports.reports,
        unusable=unusable,
    )


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
