r"""Which sensor lies? `supervised`, and a judge of its gyro.

    gyro_monitor     the gyro against torque model and attitude: jumps, noise, stuck, absent; a virtual gyro
    supervised       the attitude against the gyro, or the virtual one
    ambiguity        what may be either: by which it flies

docs/isolating.md explains it; docs/isolability.md says what is possible.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, NamedTuple

from quadftc_fdi.fault_observer import LastDiagnosis, register
from quadftc_fdi.fault_observers import supervised
from quadftc_fdi.fault_observers.supervised import Supervised
from quadftc_fdi.isolation import gyro_monitor
from quadftc_fdi.isolation.gyro_monitor import AttitudeUse, GyroMonitor
from quadftc_fdi.supervision import sensor_noise
from quadftc_fdi.supervision.inertial_filter import estimate_rate
from quadftc_model import samples
from quadftc_model.arrays import Mask, Vector, any_of, changed_where, chosen, clip, exp, namespace
from quadftc_model.parameters import parameter
from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import FaultEstimate, FaultObserverInputs, SensorDiagnosis, SensorEstimate

DEG = math.pi / 180.0
CORRELATED = 0.06  # s; how long an error of the virtual gyro lasts
BENT, JUMPED = 3.3, 4.2  # 1; standard deviations of a jump of the attitude, of the gyro
SPREAD, IMPLAUSIBLE = 0.06, 0.2  # s, rad/s; no attitude sensor creeps that fast
HUGE = 30.0 * DEG  # rad; nor by that much
BLEND = 0.3  # 1; share of the limit within which the rate goes over


class State(NamedTuple):
    """Observer state at the last sample."""

    attitude: supervised.State
    monitor: GyroMonitor
    certain: Mask  # the fault of this angle is the attitude's for sure
    spread: Vector  # mean square of gyro less estimated rate, while it is ambiguous [rad²/s²]


@register("isolating")
class Isolating(Supervised):
    """Tells faults of attitude, gyro and accelerometer apart, and flies on what is left."""

    disturbance: float = parameter(
        1.0, unit="rad/s^2/sqrt(s)", low=1e-6, doc="how fast the unknown acceleration changes (random walk)"
    )
    belief: float = parameter(
        5.0 * DEG, unit="rad", low=0.0, doc="slow discrepancy up to which gyro, not attitude, is flown"
    )

    @functools.cached_property
    def attitude_law(self) -> Supervised:
        """The observer of the attitude."""
        names = [field.name for field in dataclasses.fields(Supervised)]
        return Supervised(**{name: getattr(self, name) for name in names})

    def init(self, inputs: FaultObserverInputs) -> Any:
        """Start on the measurement."""
        return self._start(self.attitude_law.init(inputs), inputs)

    def resumed(self, inputs: FaultObserverInputs, last: LastDiagnosis) -> Any:
        """Resume with what was known of the attitude; the gyro starts as healthy."""
        return self._start(self.attitude_law.resumed(inputs, last), inputs)

    def describe(self, state: Any) -> dict[str, Vector]:
        """Return what the observer of the attitude knows besides."""
        return self.attitude_law.describe(state.attitude)

    def _start(self, attitude: supervised.State, inputs: FaultObserverInputs) -> State:
        rate = estimate_rate(attitude.filter.x, inputs.imu.body_rate)
        monitor = gyro_monitor.start_monitor(
            inputs.imu.q_xyzw, rate, inputs.torque / self.vehicle.inertia, sensor_noise.WHITE**2
        )
        zeros = namespace(rate).zeros_like(rate)
        return State(attitude, monitor, attitude.faulty, zeros)

    def step(self, state: Any, inputs: FaultObserverInputs, dt: float) -> tuple[Any, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample."""
        if isinstance(dt, float) and dt == 0.0:
            return self._first(state, inputs)
        imu, before, xp = inputs.imu, state.attitude, namespace(inputs.imu.body_rate)
        monitor = self._monitor(state, inputs, before.faulty & ~state.certain, dt)

        # the attitude against the gyro, or the virtual one
        virtual, rate = monitor.bad, monitor.filter.rate
        gyro = xp.where(virtual, rate + before.filter.x[..., :3], imu.body_rate)
        doubt = virtual * (2.0 * CORRELATED * dt) * monitor.filter.rr
        attitude, estimate = self.attitude_law.advance(before, imu, gyro, doubt, dt)

        # whose is a fault of the attitude?
        new = attitude.faulty & ~before.faulty
        abrupt = (attitude.track.still < 1.0) & (xp.abs(monitor.bend) > BENT) & ~monitor.faulty
        certain = xp.where(new, abrupt, state.certain) & attitude.faulty
        ambiguous = attitude.faulty & ~certain
        spread = state.spread + (1.0 - exp(-dt / SPREAD)) * (monitor.deviation**2 - state.spread)
        spread = spread * ambiguous
        jumped = new & (monitor.jump * estimate.fault < 0.0) & (xp.abs(monitor.jump) > JUMPED)
        large = (spread > IMPLAUSIBLE**2) | (xp.abs(estimate.fault) > HUGE)
        guilty = ambiguous & (jumped | large)
        attitude = changed_where(guilty, lambda: self._acquit(attitude, inputs, guilty), attitude)
        monitor = monitor._replace(faulty=monitor.faulty | guilty)
        ambiguous = ambiguous & ~guilty
        state = State(attitude, monitor, certain, spread)
        corrected = self._blend(estimate, rate, ambiguous)
        corrected = corrected._replace(rate_valid=corrected.rate_valid | True)
        return state, estimate._replace(corrected=corrected, sensors=self._name(state, estimate))

    def _acquit(
        self, attitude: supervised.State, inputs: FaultObserverInputs, guilty: Mask
    ) -> supervised.State:
        """Start again on the measured angles, where the fault is the gyro's."""
        kept = attitude.faulty & ~guilty
        last = LastDiagnosis(
            attitude.track.fault * kept,
            0.0 * attitude.track.fault,
            kept,
            -attitude.filter.x[..., :3],
            since=attitude.track.age * kept,
        )
        fresh = self.attitude_law.resumed(inputs, last)
        fresh = fresh._replace(
            gyro=attitude.gyro,
            gyro_before=attitude.gyro_before,
            activity=attitude.activity,
            motion=attitude.motion,
            noise=attitude.noise,
            outliers=attitude.outliers,
        )
        return chosen(any_of(guilty)[..., 0], fresh, attitude)

    def _first(self, state: State, inputs: FaultObserverInputs) -> tuple[State, FaultEstimate]:
        attitude, estimate = self.attitude_law.step(state.attitude, inputs, 0.0)
        state = state._replace(attitude=attitude)
        return state, estimate._replace(sensors=self._name(state, estimate))

    def _monitor(self, state: State, inputs: FaultObserverInputs, ambiguous: Mask, dt: float) -> GyroMonitor:
        imu, before, inertia = inputs.imu, state.attitude, self.vehicle.inertia
        xp = namespace(imu.body_rate)
        noise = before.noise.exact
        white = xp.maximum(
            noise[..., sensor_noise.SAMPLE],
            noise[..., sensor_noise.LONG] * (2.0 * sensor_noise.AVERAGED[sensor_noise.LONG] + dt) / dt,
        )
        rate, there = state.monitor.filter.rate, xp.ones_like(before.faulty)
        use = AttitudeUse(imu.q_xyzw, white, there & imu.attitude_valid[..., None], ~before.faulty)
        drive = (inputs.torque - self.vehicle.rotational_drag * rate) / inertia
        return gyro_monitor.step_monitor(
            state.monitor,
            estimate_rate(before.filter.x, imu.body_rate),
            imu.body_rate,
            there & imu.rate_valid[..., None],
            ~ambiguous,
            use,
            drive,
            gyroscopic_acceleration(inertia, rate),
            self.disturbance**2,
            dt,
        )

    def _blend(self, estimate: FaultEstimate, rate: Vector, ambiguous: Mask) -> samples.ImuSample:
        """Fly on the gyro up to a limit of the discrepancy, beyond it at this distance from the attitude."""
        xp, fault, corrected = namespace(rate), estimate.fault, estimate.corrected
        beyond = ambiguous & (xp.abs(fault) > self.belief)

        def blend() -> samples.ImuSample:
            shift = (fault - clip(fault, -self.belief, self.belief)) * ambiguous
            share = clip((xp.abs(fault) / self.belief - 1.0) / BLEND, 0.0, 1.0) * ambiguous
            angles = euler_from_quaternion(corrected.q_xyzw) + shift
            q_xyzw = xp.where(any_of(beyond), quaternion_from_euler(angles), corrected.q_xyzw)
            turning = corrected.body_rate + share * (rate - corrected.body_rate)
            return corrected._replace(q_xyzw=q_xyzw, body_rate=turning)

        return changed_where(beyond, blend, corrected)

    def _name(self, state: State, estimate: FaultEstimate) -> SensorDiagnosis:
        xp, monitor = namespace(estimate.fault), state.monitor
        faulty, ambiguous = state.attitude.faulty, state.attitude.faulty & ~state.certain
        sure = xp.where(ambiguous, 0.5, 1.0)
        attitude = SensorEstimate(
            estimate.state,
            estimate.fault,
            estimate.std_dev,
            estimate.onset_age,
            faulty * sure,
            (faulty * 1).astype(xp.uint8),
            ambiguous,
        )
        started = monitor.time > gyro_monitor.EARLY
        suspect = xp.where(monitor.outliers > 0.5, samples.SUSPECT, samples.HEALTHY)
        trusted = xp.where(started, suspect, samples.STARTING)
        out = xp.where(monitor.calm > 0.1, samples.RECOVERING, samples.FAULTY)
        named = monitor.faulty | ambiguous
        gyro = SensorEstimate(
            xp.where(named, xp.where(monitor.faulty, out, samples.FAULTY), trusted).astype(xp.uint8),
            monitor.mean,
            xp.sqrt(monitor.filter.rr + monitor.variance),
            xp.where(monitor.faulty, monitor.age, xp.where(ambiguous, estimate.onset_age, -1.0)),
            xp.where(monitor.faulty, 1.0, 0.5 * ambiguous),
            (named * 1).astype(xp.uint8),
            ambiguous & ~monitor.faulty,
        )
        zeros = xp.zeros_like(estimate.fault)
        healthy = (zeros + samples.HEALTHY).astype(xp.uint8)
        accelerometer = SensorEstimate(
            healthy, zeros, zeros - 1.0, zeros - 1.0, zeros, 0 * healthy, faulty & ~faulty
        )
        return SensorDiagnosis(attitude, gyro, accelerometer)
