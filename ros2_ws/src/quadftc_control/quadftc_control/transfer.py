"""Going over from one IMU to another without a jump: what the controller flies on is continuous.

Another source is used from a sample on. The body rate turns the attitude used so far on to it. There it
differs from the new source by a rotation delta, and the body rates differ by omega_o. From then on

    q_used = q * exp(w delta / 2),   omega_used = omega + w_o omega_o

with w = 1 at first. Towards imu/data, omega_o is what the diagnosis had last added to it (minus the gyro
bias), and stays, w_o = 1. As to delta,

* where the attitude was faulty, delta is updated at every sample, so that the body rate alone carries the
  attitude on. After a gap in imu/data it begins with the fault as last known;
* where it was not, delta is given up at once. It is found again if imu/data makes a step that the body rate
  does not explain: then a fault has begun.

So a fault is taken off for some time, in which a new observer can come. Then delta is given up, as errors of
the body rate add up, and faults end. Towards imu/corrected, delta is what has come of that, given up at once.
"""

from __future__ import annotations

import numpy as np

from quadftc_control.input_monitor import Patience
from quadftc_model import rotations
from quadftc_model.arrays import Vector, length
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, rotation_between
from quadftc_model.samples import ImuSample
from quadftc_model.stepper import MAX_GAP, seconds

# Share of the authority of an axis by which the torque may change from sample to sample because a node was
# lost or came back, beyond what it changes by otherwise; held by tests.
TORQUE_JUMP = 0.10
LONGEST = 0.1  # s; over a longer gap the body rate carries nothing on


class Transfer:
    """What the controller flies on, whichever source it comes from."""

    def __init__(self, patience: Patience) -> None:
        self.patience = patience
        self.reset()

    def reset(self) -> None:
        """Forget what was used: the next sample is taken as it is."""
        self._raw: bool | None = None
        self._used: ImuSample | None = None
        self._stamp_ns = self._since_ns = 0
        self._turn, self._rate = np.zeros(3), np.zeros(3)
        self._blending = self._held = self._reckoning = self._rate_stays = False
        self.expect(None, None)

    def expect(self, rate_correction: Vector | None, fault: Vector | None) -> None:
        """Say what is known of imu/data, before it is used in place of imu/corrected.

        What the diagnosis has last added to its body rate [rad/s], and its last fault [rad]; None: not known.
        """
        self._rate_correction, self._fault = rate_correction, fault

    def used(self, stamp_ns: int, sample: ImuSample, raw: bool) -> ImuSample:
        """Return what to fly on for a clean sample with attitude, later [ns] than that of the last call.

        ``raw`` tells whether it is of imu/data, else of imu/corrected.
        """
        elapsed = seconds(stamp_ns - self._stamp_ns)
        before = self._used if 0.0 < elapsed <= LONGEST else None
        if raw != self._raw:
            self._change(stamp_ns, sample, before, elapsed, raw)
        elif before is None:
            self._blending &= raw and 0.0 < elapsed <= MAX_GAP
        elif raw:
            self._watch(stamp_ns, sample, before, elapsed)
        self._raw, self._stamp_ns = raw, stamp_ns
        self._used = self._shifted(stamp_ns, sample)
        return self._used

    @property
    def known(self) -> bool:
        """Whether a fault of imu/data is taken off now, all of it."""
        return bool(self._raw) and self._held and self._weight(self._stamp_ns) == 1.0

    def contradicts(self, stamp_ns: int, corrected: ImuSample) -> bool:
        """Whether a sample of imu/corrected still has the fault that is taken off imu/data now.

        So it is for a moment when an observer has restarted and did not get the last words yet.
        """
        if self._used is None or not self.known:
            return False
        turn = _turn_between(corrected, self._used, seconds(stamp_ns - self._stamp_ns))
        return bool(length(turn) > self.patience.jump)

    def _change(
        self, stamp_ns: int, sample: ImuSample, before: ImuSample | None, elapsed: float, raw: bool
    ) -> None:
        """Begin with another source."""
        self._reckoning = raw and self._fault is not None
        self._rate_stays = raw and self._rate_correction is not None
        self._rate = np.zeros(3)
        if raw and self._rate_correction is not None:
            self._rate = self._rate_correction
        elif before is not None and before.rate_valid and sample.rate_valid:
            self._rate = before.body_rate - sample.body_rate
        if before is not None:
            self._begin(stamp_ns, _turn_between(sample, before, elapsed), held=self._reckoning)
        elif raw and self._fault is not None:
            right = quaternion_from_euler(euler_from_quaternion(sample.q_xyzw) - self._fault)
            self._begin(stamp_ns, rotation_between(sample.q_xyzw, right), held=True)
        else:
            self._blending = False

    def _watch(self, stamp_ns: int, sample: ImuSample, before: ImuSample, elapsed: float) -> None:
        """Update by what imu/data is off."""
        if self._reckoning and sample.rate_valid and self._weight(stamp_ns) == 1.0:
            self._turn = _turn_between(sample, before, elapsed)
            return
        turn = _turn_between(self._shifted(stamp_ns, sample), before, elapsed)
        if length(turn) > self.patience.jump:
            if not self._rate_stays:
                self._rate = self._rate * max(0.0, self._weight(stamp_ns))
            self._begin(stamp_ns, _turn_between(sample, before, elapsed), held=True)
            self._reckoning = False  # so that it ends, however often the sensor jumps

    def _begin(self, stamp_ns: int, turn: Vector, held: bool) -> None:
        self._turn, self._since_ns, self._blending, self._held = turn, stamp_ns, True, held

    def _shifted(self, stamp_ns: int, sample: ImuSample) -> ImuSample:
        weight = max(0.0, self._weight(stamp_ns))
        if weight > 0.0:
            sample = sample._replace(q_xyzw=rotations.turn(sample.q_xyzw, weight * self._turn))
        else:
            self._blending = False
        share = 1.0 if self._rate_stays else weight
        return sample._replace(body_rate=sample.body_rate + share * self._rate) if share else sample

    def _weight(self, stamp_ns: int) -> float:
        """Return w at a stamp [ns]; not positive once the difference is given up."""
        if not self._blending:
            return 0.0
        elapsed = seconds(stamp_ns - self._since_ns)
        if self._held:
            return min(1.0, 1.0 - (elapsed - self.patience.correction_hold) / self.patience.correction_fade)
        return 1.0 - elapsed / self.patience.blend


def _turn_between(sample: ImuSample, before: ImuSample, elapsed: float) -> Vector:
    """Rotation vector [rad] (3,) from a sample to where the one before has come in a time [s]."""
    turned = rotations.quaternion_from_rotation_vector(before.body_rate * elapsed)
    return rotation_between(sample.q_xyzw, rotations.quaternion_product(before.q_xyzw, turned))
