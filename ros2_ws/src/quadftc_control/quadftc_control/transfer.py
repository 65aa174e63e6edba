"""Going over from one IMU to another without a jump: what the controller flies on is continuous.

At the sample from which another source is used, the attitude used so far, turned on by the body rate, and the
new source differ by a rotation delta (and their body rates by omega_o). From then on

    q_used = q * exp(w delta / 2),   omega_used = omega + w omega_o

with w = 1 at first. Towards imu/data:

* where the attitude was faulty, delta is found anew at every sample, so that the body rate alone, less its
  bias as last known, carries the attitude on, whatever becomes of the fault;
* where it was not, delta stays, and is found anew should imu/data make a step that the body rate does not
  explain: then a fault has begun or ended.

That goes on for some time, in which a new observer can come. Then delta is given up, as errors of the body
rate add up, and faults end. Towards imu/corrected, delta is what has come of all that, given up at once.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quadftc_control.degraded import Patience
from quadftc_model.rotations import normalise, quaternion_from_rotation_vector, quaternion_product
from quadftc_model.samples import ImuSample
from quadftc_model.stepper import seconds

# Share of the authority of an axis by which the torque may change from sample to sample because a node was
# lost or came back, beyond what it changes by otherwise; held by tests.
TORQUE_JUMP = 0.10
LONGEST = 0.1  # s; over a longer gap there is nothing to go on from
_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])


class Transfer:
    """What the controller flies on, whichever source it comes from.

    Parameters
    ----------
    patience : Patience
    """

    def __init__(self, patience: Patience) -> None:
        self.patience = patience
        self.reset()

    def reset(self) -> None:
        """Forget what was used: the next sample is taken as it is."""
        self._raw: bool | None = None
        self._used: ImuSample | None = None
        self._stamp_ns = self._since_ns = 0
        self._turn, self._rate = np.zeros(3), np.zeros(3)
        self._blending = self._reckoning = False
        self.expect(None, False)

    def expect(self, rate_correction: NDArray[np.float64] | None, faulty: bool) -> None:
        """Say what is known of imu/data, before it is used in place of imu/corrected.

        Parameters
        ----------
        rate_correction : array (3,) or None
            What the diagnosis has last added to its body rate [rad/s]; None if that is not known.
        faulty : bool
            Whether its attitude was faulty.
        """
        self._rate_correction, self._faulty = rate_correction, faulty

    def used(self, stamp_ns: int, sample: ImuSample, raw: bool) -> ImuSample:
        """Return the sample to fly on.

        Parameters
        ----------
        stamp_ns : int
            [ns], later than that of the last call.
        sample : ImuSample
            Clean, of one vehicle; with attitude.
        raw : bool
            Whether it is of imu/data, else of imu/corrected.
        """
        before, elapsed = self._used, seconds(stamp_ns - self._stamp_ns)
        if before is None or not 0.0 < elapsed <= LONGEST:
            self._blending = False
        elif raw != self._raw:
            self._rate = self._rate_between(sample, before, raw)
            self._begin(stamp_ns, _turn_between(sample, before, elapsed))
            self._reckoning = raw and self._faulty
        elif raw and self._reckoning and sample.rate_valid and self._weight(stamp_ns) == 1.0:
            self._turn = _turn_between(sample, before, elapsed)
        elif raw:
            turn = _turn_between(self._shifted(stamp_ns, sample), before, elapsed)
            if math.sqrt(turn.dot(turn)) > self.patience.jump:
                self._rate = self._rate * self._weight(stamp_ns)
                self._begin(stamp_ns, _turn_between(sample, before, elapsed))
                self._reckoning = False  # so that it ends, however often the sensor jumps
        self._raw, self._stamp_ns = raw, stamp_ns
        self._used = self._shifted(stamp_ns, sample)
        return self._used

    @property
    def known(self) -> bool:
        """Whether imu/data is used, and all it is off by taken off."""
        return bool(self._raw) and self._weight(self._stamp_ns) == 1.0

    def _rate_between(self, sample: ImuSample, before: ImuSample, raw: bool) -> NDArray[np.float64]:
        if raw and self._rate_correction is not None:
            return self._rate_correction
        both = before.rate_valid and sample.rate_valid
        return before.body_rate - sample.body_rate if both else np.zeros(3)

    def _begin(self, stamp_ns: int, turn: NDArray[np.float64]) -> None:
        self._turn, self._since_ns, self._blending = turn, stamp_ns, True

    def _shifted(self, stamp_ns: int, sample: ImuSample) -> ImuSample:
        weight = self._weight(stamp_ns)
        if weight <= 0.0:
            self._blending = False
            return sample
        turn = quaternion_from_rotation_vector(weight * self._turn)
        q_xyzw = normalise(quaternion_product(sample.q_xyzw, turn))
        return sample._replace(q_xyzw=q_xyzw, body_rate=sample.body_rate + weight * self._rate)

    def _weight(self, stamp_ns: int) -> float:
        """Return w at a stamp [ns]; not positive once the difference is given up."""
        if not self._blending:
            return 0.0
        elapsed = seconds(stamp_ns - self._since_ns)
        if self._raw:
            return min(1.0, 1.0 - (elapsed - self.patience.correction_hold) / self.patience.correction_fade)
        return 1.0 - elapsed / self.patience.blend


def _turn_between(sample: ImuSample, before: ImuSample, elapsed: float) -> NDArray[np.float64]:
    """Rotation vector [rad] (3,) from a sample to where the one before has come in a time [s]."""
    turned = quaternion_from_rotation_vector(before.body_rate * elapsed)
    expected = quaternion_product(before.q_xyzw, turned)
    return rotation_vector(quaternion_product(sample.q_xyzw * _CONJUGATE, expected))


def rotation_vector(q_xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation vector [rad] (3,) of a unit quaternion (4,), at most pi long."""
    x, y, z, w = q_xyzw.tolist()
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2.0 * math.atan2(sine, abs(w))
    return q_xyzw[:3] * (math.copysign(angle / sine, w) if sine > 0.0 else 2.0)
