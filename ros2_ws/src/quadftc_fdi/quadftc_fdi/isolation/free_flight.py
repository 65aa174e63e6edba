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

from quadftc_fdi.isolation import reading_test
from quadftc_fdi.isolation.accelerometer_monitor import AccelerometerMonitor
from quadftc_fdi.isolation.reading_test import Deviation, Verdict
from quadftc_model.arrays import (
    Flag,
    Mask,
    Scalar,
    Vector,
    any_of,
    changed_where,
    clip,
    column,
    components,
    exp,
    larger,
    log,
    namespace,
    pick,
    smaller,
    stacked,
)
from quadftc_model.position_estimator import PositionEstimator, PositionEstimatorInputs, State
from quadftc_model.samples import STANDARD_GRAVITY, FaultObserverInputs, PositionSample

GUSTY = 1.0  # m/s²/sqrt(s); random walk of the drag: a gust of 5 m/s within 0.3 s is followed
LOST = 1.0  # m²/s⁴; variance of a drag of which nothing is known
WALK, ROUGH, GATE = 0.05, 0.02, 20.0  # m/s²/sqrt(s), m/s²/sqrt(Hz), 1; of the estimator of b
KNOWN = 0.2  # m/s²; standard deviation of b from which it counts
SETTLED = 1.0  # s; after which a fault of attitude or gyro has left b
OFF = 0.6  # m/s²; of b: an attitude that is 3.5 deg off and looks healthy
EARLY, LEARNED = 0.3, 20.0  # s; over which b in healthy flight is learned, at first and later
NEEDED = 2.0  # s; of learning, before b counts against attitude and gyro
LEAST = 0.012  # m/s²; of b in healthy flight, 1 sigma at least: 0.07 deg
APART, CLOSE = 0.25, 0.1  # m/s²; by which a healthy accelerometer may be off without, with a position
PULL, LOOSE = 0.5, 0.3  # s, m/s²/sqrt(s); how b is followed where the accelerometer is faulty
GROWN = 2.0  # 1; lags of b for which an attitude fault has grown, at least, when it is found
ROUGHLY = 0.3  # 1; of what is not yet due of a tilt error, 1 sigma of what is due
FINAL = 30.0  # 1; bound of log-odds


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


def start_flight(law: PositionEstimator, inputs: FaultObserverInputs) -> FreeFlight | None:
    """Start at a sample; None on the test stand."""
    if inputs.thrust is None:
        return None
    zeros = 0.0 * inputs.imu.specific_force
    zero = components(zeros)[0]
    motion = law.init(_motion_inputs(inputs))
    return FreeFlight(inputs.thrust + zero, zeros + LOST, motion, zeros, zeros, zero, zero, zeros)


def predict_force(state: FreeFlight, thrust: Scalar, lag: float, dt: float) -> tuple[FreeFlight, Scalar]:
    """Predict by a commanded thrust [N]; return what is known then, and the thrust that acts [N]."""
    acts = state.thrust + (1.0 - exp(-dt / larger(lag, 1e-9))) * (thrust - state.thrust)
    xp = namespace(state.unsure)
    return state._replace(thrust=acts, unsure=xp.minimum(state.unsure + GUSTY**2 * dt, LOST)), acts


def deviation_of(offset: Vector, force: Vector, thrust: Scalar, mass: float) -> Vector:
    """What a reading [m/s²] has too much, with the thrust [N] and the drag ``offset`` [m/s²]."""
    x, y, z = components(force - offset)
    return stacked([x, y, z - thrust / mass])


def step_flight(
    state: FreeFlight,
    law: PositionEstimator,
    monitor: AccelerometerMonitor,
    inputs: FaultObserverInputs,
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
    motion, _ = law.step(state.motion, _motion_inputs(inputs), dt)
    settled = pick(any_of(doubtful)[..., 0], 0.0 * state.settled, state.settled + dt)
    known = column(_known(motion) & (settled > SETTLED))
    excess = motion.bias - state.base
    used = verdict.good & ~monitor.faulty
    gain = used * state.unsure / (state.unsure + noise)
    offset, unsure = monitor.offset + gain * deviation, (1.0 - gain) * state.unsure
    far = known & (excess * excess > OFF**2)

    def judge() -> tuple[Mask, Vector, State, Mask, Deviation]:
        late = far & ~monitor.faulty
        alarm = ~monitor.faulty & (verdict.stuck | verdict.odd | far)
        begun = monitor.offset + late * (deviation - excess)
        off, alive = deviation - late * (deviation - excess), there & ~verdict.stuck
        close = noise + pick(known, CLOSE**2 + column(components(motion.covariance)[5]), APART**2)
        faulty, fault = reading_test.follow_deviation(
            monitor.fault, monitor.faulty | alarm, alarm, alive, suspicion, off, noise, close, dt
        )
        pulled = begun + (dt / PULL) * (faulty & known) * (off - excess)
        xp = namespace(offset)
        kept = xp.where(faulty, pulled, offset)
        return used & ~alarm, kept, _loosened(motion, faulty, alarm, dt), faulty, fault

    strange = monitor.faulty | verdict.stuck | verdict.odd | far
    used, offset, motion, faulty, fault = changed_where(
        strange, judge, (used, offset, motion, monitor.faulty, monitor.fault)
    )
    monitor = AccelerometerMonitor(offset, excess * known, faulty, fault)
    base, spread, learned = _learned(state, excess, known & ~any_of(faulty | far), dt)
    after = FreeFlight(state.thrust, unsure, motion, base, spread, learned, settled, state.due)
    return after, monitor, used


def follow_tilt(
    state: FreeFlight, fault: Vector, age: Vector, new: Mask, abrupt: Mask, dt: float
) -> FreeFlight:
    """Follow what b shows of attitude faults [rad] of an age [s].

    ``new`` ones have grown evenly so far. Unless they are ``abrupt``, that was for `GROWN` lags at least: a
    slow fault is found late.
    """
    xp, lag = namespace(fault), column(components(state.motion.covariance)[5]) / WALK**2
    ago = xp.maximum(age, xp.where(abrupt, dt, GROWN * lag))
    grown = fault * (1.0 - lag / ago * (1.0 - exp(-ago / lag)))
    return state._replace(due=xp.where(new, grown, state.due + (1.0 - exp(-dt / lag)) * (fault - state.due)))


def vote(state: FreeFlight, monitor: AccelerometerMonitor, fault: Vector, std_dev: Vector) -> Vector:
    """Log-odds by the position, gyro over attitude, of an attitude fault [rad] known to ``std_dev`` [rad].

    The tilt error by b is normal: about 0 where the gyro is wrong, about what is due where the attitude is.
    """
    x, y, _ = components((state.motion.bias - state.base) / STANDARD_GRAVITY)
    sx, sy, _ = components(state.spread / STANDARD_GRAVITY**2)
    unsure = std_dev * std_dev + (ROUGHLY * (fault - state.due)) ** 2
    (roll, pitch, _), (ur, up, _) = components(state.due), components(unsure)
    least = (LEAST / STANDARD_GRAVITY) ** 2
    counts = _known(state.motion) & (state.learned > NEEDED) & ~any_of(monitor.faulty)[..., 0]

    def odds(tilt: Scalar, size: Scalar, spread: Scalar, unsure: Scalar) -> Scalar:
        own = least + spread
        both = own + unsure
        said = (tilt - size) ** 2 / both - tilt**2 / own + log(both / own)
        return counts * clip(0.5 * said, -FINAL, FINAL)

    return stacked([odds(-y, roll, sy, ur), odds(x, pitch, sx, up), 0.0 * x])


def _motion_inputs(inputs: FaultObserverInputs) -> PositionEstimatorInputs:
    """Inputs of the estimator of b; without a position sensor, no sample is there."""
    sample, force = inputs.position, inputs.imu.specific_force
    if sample is None:
        zeros = 0.0 * force
        sample = PositionSample(zeros, zeros, inputs.imu.force_valid & ~inputs.imu.force_valid)
    return PositionEstimatorInputs(inputs.imu, sample)


def _known(motion: State) -> Flag:
    return motion.started & (components(motion.covariance)[5] < KNOWN**2)


def _learned(state: FreeFlight, excess: Vector, calm: Mask, dt: float) -> tuple[Vector, Vector, Scalar]:
    """Learn b in healthy flight: mean, mean square of its changes, and for how long."""
    gain = calm * column(dt / (EARLY + state.learned))
    learned = smaller(state.learned + dt * components(calm)[0], 0.0 * state.learned + LEARNED)
    return state.base + gain * excess, state.spread + gain * (excess * excess - state.spread), learned


def _loosened(motion: State, faulty: Mask, alarm: Mask, dt: float) -> State:
    """Let b follow a faulty accelerometer faster."""
    *others, bb = components(motion.covariance)
    more = any_of(faulty)[..., 0] * LOOSE**2 * dt + any_of(alarm)[..., 0] * LOST
    return motion._replace(covariance=stacked([*others, bb + more]))
