"""Every sample of one flight of a batch, as the closed loop without ROS gives it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.loop import Row
from quadftc_flight.flight import NO_STATE, Flight, onset_ns
from quadftc_model.stepper import NANOSECONDS_PER_SECOND


def flight_of(row: Row, period_ns: int, epoch_ns: int) -> Flight:
    """Make a flight of rows of one lane, arrays (samples, ...).

    Parameters
    ----------
    row : Row
    period_ns : int
        Of the samples [ns].
    epoch_ns : int
        Stamp of the first sample [ns].
    """
    there = np.asarray(row.delivered, np.bool_)
    stamp_ns = epoch_ns + period_ns * np.arange(len(there))
    estimate, output = row.estimate, row.output

    def known(values: Any) -> NDArray[np.float64]:
        return np.where(there[:, None], np.asarray(values, np.float64), np.nan)

    return Flight(
        stamp_ns=stamp_ns,
        time=(stamp_ns - epoch_ns) / NANOSECONDS_PER_SECOND,
        delivered=there,
        angles=np.asarray(row.angles, np.float64),
        body_rate=np.asarray(row.body_rate, np.float64),
        disturbance=np.asarray(row.disturbance, np.float64),
        reference=known(row.reference),
        fault=known(row.fault),
        fault_estimate=known(estimate.fault),
        fault_std_dev=known(estimate.std_dev),
        fault_state=np.where(there[:, None], estimate.state, NO_STATE).astype(np.uint8),
        fault_onset_ns=np.where(
            there[:, None], onset_ns(stamp_ns[:, None], np.asarray(estimate.onset_age, np.float64)), 0
        ),
        disturbance_estimate=known(row.disturbance_estimate),
        torque=known(output.torque),
        error=known(output.error),
        sliding_variable=known(output.sliding_variable),
        saturated=there[:, None] & output.saturated,
    )
