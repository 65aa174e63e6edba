"""No diagnosis: the controller gets the IMU as it is. The comparison for fault-tolerant flight."""

from __future__ import annotations

from typing import ClassVar

from quadftc_fdi.fault_observer import FaultObserver, assume_healthy, register
from quadftc_model.arrays import column, namespace, where
from quadftc_model.samples import FaultEstimate, FaultObserverInputs, ImuSample


@register("none")
class NoDiagnosis(FaultObserver):
    """Passes the sample on; an absent channel keeps its last value."""

    has_detector: ClassVar[bool] = False

    def init(self, inputs: FaultObserverInputs) -> ImuSample:
        """Remember the first sample."""
        return inputs.imu

    def step(
        self, state: ImuSample, inputs: FaultObserverInputs, dt: float
    ) -> tuple[ImuSample, FaultEstimate]:
        """Return the sample as it is, with an estimate of zero."""
        imu = inputs.imu
        used = imu._replace(
            q_xyzw=where(column(imu.attitude_valid), imu.q_xyzw, state.q_xyzw),
            body_rate=where(column(imu.rate_valid), imu.body_rate, state.body_rate),
        )
        return used, assume_healthy(namespace(imu.body_rate).zeros_like(imu.body_rate), used)
