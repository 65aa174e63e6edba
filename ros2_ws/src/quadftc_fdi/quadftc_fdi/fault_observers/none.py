"""No diagnosis: the controller gets the IMU as it is. The comparison for fault-tolerant flight."""

from __future__ import annotations

import dataclasses

from quadftc_fdi.fault_observer import FaultObserver, register
from quadftc_model.arrays import Array, namespace
from quadftc_model.samples import HEALTHY, FaultEstimate, FaultObserverInputs, ImuSample


@register("none")
@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class NoDiagnosis(FaultObserver):
    """Passes the sample on; an absent channel keeps its last value."""

    def init(self, inputs: FaultObserverInputs) -> ImuSample:
        """Remember the first sample."""
        return inputs.imu

    def step(
        self, state: ImuSample, inputs: FaultObserverInputs, dt: float
    ) -> tuple[ImuSample, FaultEstimate]:
        """Return the sample as it is, with an estimate of zero."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        used = imu._replace(
            q_xyzw=_or_last(imu.attitude_valid, imu.q_xyzw, state.q_xyzw),
            body_rate=_or_last(imu.rate_valid, imu.body_rate, state.body_rate),
        )
        zeros = xp.zeros_like(imu.body_rate)
        estimate = FaultEstimate(
            fault=zeros,
            std_dev=xp.full_like(zeros, -1.0),
            state=xp.full_like(zeros, HEALTHY, dtype=xp.uint8),
            onset_age=xp.full_like(zeros, -1.0),
            corrected=used,
        )
        return used, estimate


def _or_last(valid: Array, value: Array, last: Array) -> Array:
    return namespace(value).where(valid[..., None], value, last)
