"""A recording through the diagnosis, sample by sample, as the graph does it; nothing of ROS is in between."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_flight.flight import NO_STATE, Flight, onset_ns, unknown_flight
from quadftc_model.rotations import wrap
from quadftc_model.samples import FaultEstimate, ImuSample
from quadftc_replay.imu_recording import Floats, Recording
from quadftc_sim.injection import TRUTH
from quadftc_sim.injector import FaultInjector

Progress = Callable[[float], None]  # called with the share of the samples that are done
STRIDE = 256  # samples between two calls


@dataclasses.dataclass(eq=False, kw_only=True)
class Diagnosed:
    """What became of each sample; in the rows of withheld samples all is NaN, zero or absent."""

    delivered: NDArray[np.bool_]  # (n,) False: an overlaid fault withheld the sample
    seen: ImuSample  # what the observer saw: the samples with the overlaid faults; leading axis n
    overlaid: dict[str, Floats]  # channel to the overlaid fault (n, 3), of withheld samples too
    estimate: FaultEstimate  # leading axis n
    unusable: int = 0  # samples with an estimate that could not be used; the observer restarted after each


def diagnose(
    recording: Recording, law: FaultObserver, injector: FaultInjector, progress: Progress | None = None
) -> Diagnosed:
    """Put the faults of an injector, which is used up, on the samples, and diagnose them."""
    diagnosis, result = Diagnosis(law), _blank(len(recording))
    for row, stamp_ns in enumerate(recording.stamp_ns.tolist()):
        # what the fault injector makes of the sample
        injected = injector.apply(stamp_ns, ImuSample(*(column[row] for column in recording.imu)))
        for channel, overlaid in result.overlaid.items():
            overlaid[row] = getattr(injected, channel)
        # what the observer makes of it, if it is not withheld
        if injected.present:
            estimate = diagnosis.diagnose(stamp_ns, injected.sample, recording.torque[row])
            assert estimate is not None  # stamps increase
            result.delivered[row] = True
            _set_row(result.seen, row, injected.sample)
            _set_row(result.estimate, row, estimate)
        if progress is not None and row % STRIDE == 0:
            progress(row / len(recording))
    result.unusable = diagnosis.replaced
    return result


def flight_of(recording: Recording, diagnosed: Diagnosed) -> Flight:
    """Return the replayed flight: time, the true fault and what the observer said; all else is unknown."""
    rows, said, flight = diagnosed.delivered, diagnosed.estimate, unknown_flight(recording.stamp_ns)
    flight.delivered[:] = rows
    flight.fault[rows] = true_fault(recording, diagnosed, "attitude")[rows]
    flight.fault_estimate[:], flight.fault_std_dev[:] = said.fault, said.std_dev
    flight.fault_state[:] = said.state
    flight.fault_onset_ns[:] = onset_ns(recording.stamp_ns[:, None], said.onset_age)
    return flight


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
    state = np.full((count, 3), NO_STATE, np.uint8)
    return Diagnosed(
        delivered=np.zeros(count, np.bool_),
        seen=seen,
        overlaid={channel: np.zeros((count, 3)) for channel in TRUTH},
        estimate=FaultEstimate(fault, std_dev, state, onset_age, corrected),
    )


def _set_row(columns: tuple[Any, ...], row: int, values: tuple[Any, ...]) -> None:
    """Set a row of columns, and of the columns inside them."""
    for column, value in zip(columns, values, strict=True):
        if isinstance(column, tuple):
            _set_row(column, row, value)  # pyright: ignore[reportUnknownArgumentType]
        else:
            column[row] = value
