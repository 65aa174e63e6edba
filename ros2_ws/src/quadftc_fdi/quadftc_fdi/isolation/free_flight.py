r"""Free flight: the accelerometer against the thrust, and attitude and accelerometer against the position.

An accelerometer feels thrust and drag, whatever the attitude (Martin and Salaün 2010): f = (0, 0, T / m) + d.
T follows its command by the rotors' lag. The drag d is followed as a random walk, so fast that no gust is a
fault. What is left are jumps, noise and silence, which `reading_test` finds.

A position sensor sees the rest. `PositionEstimator`, on attitude and specific force as measured, finds the
bias b that the accelerometer seems to have. An attitude that is off in tilt moves b, too, by gravity:

    b = (g pitch error, -g roll error, 0) + error of the accelerometer

What b is in healthy flight is learned. So b says whose a discrepancy s of attitude and gyro is: b / g is s
where the attitude is wrong, and 0 where the gyro is. But b follows late. Its variance is P = q² T, where q is
its walk and T its lag in steady state. So where the attitude is wrong, b / g is "due" to be s behind a lag T.
Without a discrepancy it is the accelerometer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.fault_observer import SHORTEST
from quadftc_fdi.isolation import accelerometer_monitor, reading_test
from quadftc_fdi.isolation.accelerometer_monitor import AccelerometerMonitor
from quadftc_fdi.isolation.reading_test import Verdict
from quadftc_model.arrays import (
    Flag,
    Mask,
    Quaternion,
    Scalar,
    Vector,
    any_of,
    clip,
    column,
    components,
    exp,
    larger,
    log,
    namespace,
    smaller,
    stacked,
    where,
)
from quadftc_model.position_estimator import PositionEstimator, PositionEstimatorInputs, State
from quadftc_model.rotations import earth_z_in_body
from quadftc_model.samples import STANDARD_GRAVITY, FaultObserverInputs
from quadftc_model.vehicle import Vehicle

GUSTY = 1.0  # m/s²/sqrt(s); random walk of the drag: a gust of 5 m/s within 0.3 s is followed
LOST = 1.0  # m²/s⁴; variance of a drag of which nothing is known
WALK, ROUGH, GATE = 0.05, 0.02, 20.0  # m/s²/sqrt(s), m/s²/sqrt(Hz), 1; of the estimator of b
KNOWN = 0.2  # m/s²; standard deviation of b from which it counts
SETTLED = 1.0  # s; after which a fault of attitude or gyro has left b
OFF = 0.6  # m/s²; of b: an attitude that is 3.5 deg off and looks healthy
EARLY, LEARNED = 0.3, 20.0  # s; over which b in healthy flight is learned, at first and later
NEEDED = 2.0  # s; of learning, before b counts against attitude and gyro
LEAST = 0.012  # m/s²; of b in healthy flight, 1 sigma at least: 0.07 deg
APART = 0.25  # m/s²; by which a healthy accelerometer may be off
PULL, LOOSE = 0.5, 0.3  # s, m/s²/sqrt(s); how b is followed where the accelerometer is faulty
FINAL = 30.0  # 1; bound of log-odds
TILTS = np.array([True, True, False])  # of which the position says something


class FreeFlight(NamedTuple):
    """What is known of thrust, drag and motion."""

    thrust: Scalar  # of the rotors, behind their lag [N]
    unsure: Vector  # variance of the drag [m²/s⁴]
    motion: State  # by attitude and specific force as measured
    base: Vector  # b in healthy flight [m/s²]
    spread: Vector  # mean square of its changes [m²/s⁴]
    learned: Scalar  # for how long it has been learned [s]
    settled: Scalar  # since attitude or gyro were last in doubt [s]
    due: Vector  # part of the attitude's faults that b shows by now, if they are the attitude's [rad]


def motion_law(delay: float, noise: float, gives_velocity: bool, velocity_noise: float) -> PositionEstimator:
    """Return the estimator of b for a position sensor."""
    return PositionEstimator(
        delay=delay,
        noise=noise,
        gives_velocity=gives_velocity,
        velocity_noise=velocity_noise,
        acceleration_noise=ROUGH,
        bias_walk=WALK,
        gate=GATE,
    )


def start_flight(law: PositionEstimator, inputs: PositionEstimatorInputs, thrust: Scalar) -> FreeFlight:
    """Start at a sample, with a commanded thrust [N]."""
    zeros = namespace(inputs.imu.specific_force).zeros_like(inputs.imu.specific_force)
    zero = zeros[..., 0]
    return FreeFlight(thrust + zero, zeros + LOST, law.init(inputs), zeros, zeros, zero, zero, zeros)


def motion_inputs(inputs: FaultObserverInputs) -> PositionEstimatorInputs:
    """Return what the estimator of b sees of a sample in free flight."""
    assert inputs.position is not None
    return PositionEstimatorInputs(inputs.imu, inputs.position)


def force_deviation(
    state: FreeFlight | None,
    monitor: AccelerometerMonitor,
    vehicle: Vehicle,
    inputs: FaultObserverInputs,
    q_xyzw: Quaternion,
    dt: Scalar,
) -> tuple[FreeFlight | None, Vector, Vector]:
    """What the accelerometer reads too much, against gravity or thrust [m/s²], and the variance of that.

    Without a state, on a test stand, gravity is that at an attitude.
    """
    force = inputs.imu.specific_force
    if state is None or inputs.thrust is None:
        off = accelerometer_monitor.deviation_of(monitor, force, earth_z_in_body(q_xyzw))
        return None, off, namespace(off).zeros_like(off)
    lag: Scalar | float = vehicle.rotors.time_constant
    if inputs.rotors is not None:
        lag = where(inputs.rotors.measured, 0.0, lag)
    flight, thrust = predict_force(state, inputs.thrust, lag, dt)
    return flight, deviation_of(monitor.offset, force, thrust, vehicle.mass), flight.unsure


def predict_force(state: FreeFlight, thrust: Scalar, lag: Scalar, dt: Scalar) -> tuple[FreeFlight, Scalar]:
    """Predict by a commanded thrust [N]; return what is known then, and the thrust that acts [N]."""
    acts = state.thrust + (1.0 - exp(-dt / larger(lag, SHORTEST))) * (thrust - state.thrust)
    return state._replace(thrust=acts, unsure=smaller(state.unsure + GUSTY**2 * dt, LOST)), acts


def deviation_of(offset: Vector, force: Vector, thrust: Scalar, mass: float) -> Vector:
    """What a reading [m/s²] has too much, with the thrust [N] and the drag ``offset`` [m/s²]."""
    x, y, z = components(force - offset)
    return stacked([x, y, z - thrust / mass])


def step_flight(
    state: FreeFlight,
    law: PositionEstimator,
    monitor: AccelerometerMonitor,
    inputs: PositionEstimatorInputs,
    deviation: Vector,
    noise: Vector,
    suspicion: Vector,
    there: Mask,
    verdict: Verdict,
    doubtful: Mask,
    dt: float,
) -> tuple[FreeFlight, AccelerometerMonitor, Mask]:
    """Advance by ``dt`` [s] to a reading of `deviation_of`, after `predict_force`.

    ``noise`` is the variance of a reading, ``suspicion`` [s] how long there have been outliers. ``doubtful``:
    attitude or gyro is in doubt. Also return where the noise may be learned.
    """
    motion, _ = law.step(state.motion, inputs, dt)
    settled = where(any_of(doubtful)[..., 0], 0.0, state.settled + dt)
    known = column(_known(motion) & (settled > SETTLED))
    excess = motion.bias - state.base
    used = verdict.good & ~monitor.faulty
    gain = used * state.unsure / (state.unsure + noise)
    offset, unsure = monitor.offset + gain * deviation, (1.0 - gain) * state.unsure
    far = known & (excess * excess > OFF**2)
    # judge; a fault that b shows is as large as b says
    late, alarm = far & ~monitor.faulty, ~monitor.faulty & (verdict.stuck | verdict.odd | far)
    moved = where(late, deviation - excess, 0.0)
    off, alive = deviation - moved, there & ~verdict.stuck
    faulty, fault = reading_test.follow_deviation(
        monitor.fault, monitor.faulty | alarm, alarm, alive, suspicion, off, noise, noise + APART**2, dt
    )
    # b pulls the offset of a faulty one
    pulled = monitor.offset + moved + (dt / PULL) * where(faulty & known, off - excess, 0.0)
    monitor = AccelerometerMonitor(where(faulty, pulled, offset), excess * known, faulty, fault)
    base, spread, learned = _learned(state, excess, known & ~any_of(faulty | far), dt)
    motion = _loosened(motion, faulty, alarm, dt)
    after = FreeFlight(state.thrust, unsure, motion, base, spread, learned, settled, state.due)
    return after, monitor, used & ~alarm


def follow_tilt(state: FreeFlight, fault: Vector, age: Vector, new: Mask, dt: Scalar) -> FreeFlight:
    """Follow what b shows of attitude faults [rad] of an age [s]. ``new`` ones have grown evenly so far."""
    lag = column(larger(lag_of(state), SHORTEST))
    ago = larger(age, larger(dt, SHORTEST))
    grown = fault * (1.0 - lag / ago * (1.0 - exp(-ago / lag)))
    return state._replace(due=where(new, grown, state.due + (1.0 - exp(-dt / lag)) * (fault - state.due)))


def vote(state: FreeFlight, monitor: AccelerometerMonitor, fault: Vector, std_dev: Vector) -> Vector:
    """Log-odds by the position, gyro over attitude, of an attitude fault [rad] known to ``std_dev`` [rad].

    The tilt error by b is normal: about 0 where the gyro is wrong, about what is due where the attitude is.
    """
    tilt, own, counts = tilt_of(state, monitor)
    both = own + std_dev * std_dev
    said = (tilt - state.due) ** 2 / both - tilt**2 / own + log(both / own)
    return where(counts, clip(0.5 * said, -FINAL, FINAL), 0.0)


def tilt_of(state: FreeFlight, monitor: AccelerometerMonitor) -> tuple[Vector, Vector, Mask]:
    """Tilt error of the attitude by b [rad], its variance in healthy flight, and where it counts (..., 3)."""
    x, y, _ = components((state.motion.bias - state.base) / STANDARD_GRAVITY)
    sx, sy, _ = components(state.spread / STANDARD_GRAVITY**2)
    none = namespace(x).zeros_like(x)
    counts = _known(state.motion) & (state.learned > NEEDED) & ~any_of(monitor.faulty)[..., 0]
    own = (LEAST / STANDARD_GRAVITY) ** 2 + stacked([sy, sx, none])
    return stacked([-y, x, none]), own, column(counts) & TILTS


def lag_of(state: FreeFlight) -> Scalar:
    """How late b follows [s]."""
    return _bias_variance(state.motion) / WALK**2


def _known(motion: State) -> Flag:
    return motion.started & (_bias_variance(motion) < KNOWN**2)


def _bias_variance(motion: State) -> Scalar:
    return motion.covariance[..., 5]


def _learned(state: FreeFlight, excess: Vector, calm: Mask, dt: Scalar) -> tuple[Vector, Vector, Scalar]:
    """Learn b in healthy flight: mean, mean square of its changes, and for how long."""
    gain = calm * column(dt / (EARLY + state.learned))
    learned = smaller(state.learned + dt * calm[..., 0], LEARNED)
    return state.base + gain * excess, state.spread + gain * (excess * excess - state.spread), learned


def _loosened(motion: State, faulty: Mask, alarm: Mask, dt: Scalar) -> State:
    """Let b follow a faulty accelerometer faster."""
    more = any_of(faulty)[..., 0] * LOOSE**2 * dt + any_of(alarm)[..., 0] * LOST
    *others, bb = components(motion.covariance)
    return motion._replace(covariance=stacked([*others, bb + more]))
