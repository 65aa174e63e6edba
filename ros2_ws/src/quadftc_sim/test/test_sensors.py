"""The IMU: ideal means the truth, and noise has the statistics of its parameters."""

import numpy as np
import pytest

from quadftc_model.parameters import build
from quadftc_model.rotations import normalise, quaternion_from_rotation_vector, quaternion_product
from quadftc_sim.sensor_draws import DRAWS, WHITE, SensorDraws, TurnOn
from quadftc_sim.sensors import GRADES, STANDARD_GRAVITY, WANDER_TIMES, ImuInputs, ImuSensor, resting_force

LEVEL, STILL = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
COUNT = 40_000  # sigma of a standard deviation: 1 / sqrt(2 * 3 * COUNT) = 0.2 %


def attitude():
    return normalise(np.array([0.1, -0.2, 0.3, 0.9]))


def draws(*shape):
    return np.random.default_rng(4).standard_normal((*shape, *DRAWS))


def begun(sensor, *shape, bias=STILL):
    """The state of sensors with a gyro bias and no other lasting error."""
    squares = np.zeros((*shape, 3, 3))
    state = sensor.init(TurnOn(np.zeros((*shape, 3)), squares, squares))
    return state._replace(gyro_bias=state.gyro_bias + bias)


def measure(sensor, state, q_xyzw, body_rate, numbers, dt=0.004):
    """The next state and the sample of a body that does not accelerate."""
    state, output = sensor.step(state, ImuInputs(q_xyzw, body_rate, resting_force(q_xyzw), numbers), dt)
    return state, output.sample


def batch(sensor, dt):
    """A measurement of many level vehicles at rest, one after the other in the first axis."""
    level, still = np.broadcast_to(LEVEL, (COUNT, 4)), np.zeros((COUNT, 3))
    return measure(sensor, begun(sensor, COUNT), level, still, draws(COUNT), dt)[1]


def test_ideal_grade_returns_the_truth():
    sensor = build(ImuSensor, GRADES["ideal"])
    rate = np.array([0.1, -0.2, 0.3])
    state = sensor.init(SensorDraws(1).turn_on)
    _, sample = measure(sensor, state, attitude(), rate, draws())
    assert np.array_equal(sample.q_xyzw, attitude())
    assert np.array_equal(sample.body_rate, rate)
    assert sample.attitude_valid & sample.rate_valid & sample.force_valid


def test_accelerometer_measures_the_reaction_to_gravity():
    q_xyzw = attitude()
    _, sample = measure(ImuSensor(), begun(ImuSensor()), q_xyzw, STILL, draws())
    conjugate = q_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
    earth = quaternion_product(quaternion_product(q_xyzw, np.append(sample.specific_force, 0.0)), conjugate)
    np.testing.assert_allclose(earth[:3], [0.0, 0.0, STANDARD_GRAVITY], atol=1e-12)


@pytest.mark.parametrize("rate", [125, 250, 1000])
def test_gyro_noise_is_the_angle_random_walk_over_the_root_of_the_period(rate):
    sample = batch(ImuSensor(gyro_noise=1e-3), 1.0 / rate)
    assert np.std(sample.body_rate) == pytest.approx(1e-3 * np.sqrt(rate), rel=0.01)


def test_attitude_noise_has_its_standard_deviation():
    sample = batch(ImuSensor(attitude_noise=0.002), 0.004)
    assert 2.0 * np.std(sample.q_xyzw[:, :3]) == pytest.approx(0.002, rel=0.01)


def test_accelerometer_noise_has_its_standard_deviation():
    sample = batch(ImuSensor(accelerometer_noise=0.02), 0.004)
    assert np.std(sample.specific_force - [0.0, 0.0, STANDARD_GRAVITY]) == pytest.approx(0.02, rel=0.01)


@pytest.mark.parametrize("dt", [0.004, 0.016])
def test_variance_of_the_bias_grows_with_the_time(dt):
    sensor, vehicles, steps = ImuSensor(gyro_bias_walk=1e-3), 20_000, 25
    level, still = np.broadcast_to(LEVEL, (vehicles, 4)), np.zeros((vehicles, 3))
    state = begun(sensor, vehicles)
    generator = np.random.default_rng(5)
    for _ in range(steps):
        numbers = generator.standard_normal((vehicles, *DRAWS))
        state, _ = measure(sensor, state, level, still, numbers, dt)
    assert np.var(state.gyro_bias) == pytest.approx(1e-6 * steps * dt, rel=0.02)


def test_noise_of_the_channels_is_independent():
    sample = batch(ImuSensor(attitude_noise=0.1, gyro_noise=0.1, accelerometer_noise=0.1), 0.004)
    columns = np.concatenate([sample.q_xyzw[:, :3], sample.body_rate, sample.specific_force], axis=-1)
    correlation = np.corrcoef(columns.T) - np.eye(9)
    assert np.max(np.abs(correlation)) < 5.0 / np.sqrt(COUNT)


def test_turn_on_bias_spans_its_bound():
    drawn = SensorDraws(1).turn_on._replace(uniform=np.array([-1.0, 0.5, 1.0]))
    state = ImuSensor(gyro_bias=0.02).init(drawn)
    np.testing.assert_allclose(state.gyro_bias, [-0.02, 0.01, 0.02], rtol=1e-15)


def test_white_noise_is_that_of_the_seed_with_and_without_slow_errors():
    lean, full, generator = SensorDraws(3), SensorDraws(3), np.random.default_rng(3)
    assert np.array_equal(lean.turn_on.uniform, generator.uniform(-1.0, 1.0, 3))
    white, numbers = generator.standard_normal((3, WHITE, 3)), [full.next(count, True) for count in (1, 2)]
    assert np.array_equal(lean.next(3, slow=False), white)
    assert np.array_equal(np.concatenate(numbers)[:, :WHITE], white)


def test_sensor_without_slow_errors_measures_to_the_bit_by_white_noise_alone():
    grade, numbers, rate = GRADES["mems"] | {"delay": 0}, draws(), np.array([0.1, -0.2, 0.3])
    sensor, bias = build(ImuSensor, grade), np.array([0.01, 0.0, -0.01])
    _, sample = measure(sensor, begun(sensor, bias=bias), attitude(), rate, numbers)
    tilt = quaternion_from_rotation_vector(grade["attitude_noise"] * numbers[0])
    assert np.array_equal(sample.q_xyzw, quaternion_product(attitude(), tilt))
    noise = grade["gyro_noise"] / np.sqrt(0.004) * numbers[1]
    assert np.array_equal(sample.body_rate, rate + bias + noise)


def wandering(rate, seconds=40.0, dt=0.01, vehicles=400, **parameters):
    """Attitude errors [rad] (samples, vehicles, 3) of level vehicles, seen while they turn at a rate."""
    sensor, generator = ImuSensor(**parameters), np.random.default_rng(6)
    level, turning = np.broadcast_to(LEVEL, (vehicles, 4)), np.full((vehicles, 3), rate)
    zeros, wander = np.zeros((vehicles, 3, 3)), generator.standard_normal((vehicles, 3, 3))
    start = TurnOn(zeros[:, 0], zeros, wander)
    state, errors = sensor.init(start), []
    for _ in range(round(seconds / dt)):
        numbers = generator.standard_normal((vehicles, *DRAWS))
        state, sample = measure(sensor, state, level, turning, numbers, dt)
        errors.append(2.0 * sample.q_xyzw[:, :3])
    return np.stack(errors)


def test_slow_error_keeps_its_standard_deviation_from_the_start():
    errors = wandering(0.0, seconds=4.0, attitude_wander=0.004)
    assert np.std(errors[0]) == pytest.approx(0.004, rel=0.05)
    assert np.std(errors[-100:]) == pytest.approx(0.004, rel=0.05)


def test_slow_error_is_correlated_over_its_correlation_times():
    errors = wandering(0.0, dt=0.02, attitude_wander=0.004)
    for lag in (0.1, 1.0):
        apart = round(lag / 0.02)
        measured = np.mean(errors[apart:] * errors[:-apart]) / np.mean(errors**2)
        assert measured == pytest.approx(np.mean(np.exp(-lag / np.array(WANDER_TIMES))), abs=0.02)


def test_slow_error_grows_with_the_rate_after_a_while():
    errors = wandering(0.5, seconds=15.0, attitude_wander=0.001, attitude_wander_moving=0.002)
    assert np.std(errors[0]) == pytest.approx(0.001, rel=0.05)
    assert np.std(errors[1000:]) == pytest.approx(0.001 + 0.002 * 1.5, rel=0.05)


def test_attitude_lags_the_gyro():
    angle, rate = 0.3, 8.0
    turned = np.array([0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)])
    sensor = ImuSensor(attitude_lag=0.01)
    _, sample = measure(sensor, begun(sensor), turned, np.array([0.0, rate, 0.0]), draws())
    earlier = (angle - 0.01 * rate) / 2
    np.testing.assert_allclose(sample.q_xyzw, [0.0, np.sin(earlier), 0.0, np.cos(earlier)], atol=1e-12)


def test_gyro_error_is_a_matrix_drawn_once():
    sensor, drawn = ImuSensor(gyro_scale=0.01), SensorDraws(5).turn_on
    state, rate = sensor.init(drawn), np.array([2.0, -1.0, 3.0])
    for _ in range(2):
        state, sample = measure(sensor, state, LEVEL, rate, draws())
        np.testing.assert_allclose(sample.body_rate, rate + 0.01 * drawn.gyro @ rate, rtol=1e-12)


def test_bias_is_added_to_the_rate():
    sensor = ImuSensor()
    bias = np.array([0.1, 0.2, 0.3])
    _, sample = measure(sensor, begun(sensor, bias=bias), LEVEL, np.ones(3), draws())
    np.testing.assert_allclose(sample.body_rate, [1.1, 1.2, 1.3], rtol=1e-15)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_sample_comes_out_as_many_steps_later(delay):
    sensor = ImuSensor(delay=delay)
    state, out = begun(sensor), []
    for index in range(6):
        inputs = ImuInputs(LEVEL, np.full(3, float(index)), resting_force(LEVEL), draws())
        state, output = sensor.step(state, inputs, 0.004)
        out.append(output.sample.body_rate[0] if output.there else None)
    assert out == [None] * delay + [float(index) for index in range(6 - delay)]
