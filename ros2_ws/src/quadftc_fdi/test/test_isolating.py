"""The observer isolating on a vehicle that hovers: which sensor it names, what it gives the controller."""

import copy
import functools

import numpy as np
import pytest
from in_c import as_flown, fly_law

from quadftc_fdi.fault_observers.isolating import Isolating
from quadftc_fdi.isolation import hypotheses, rate_filter
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, turn
from quadftc_model.samples import (
    ALARMS,
    FAULT_KINDS,
    FAULTY,
    HEALTHY,
    SUSPECT,
    FaultObserverInputs,
    level_sample,
)
from quadftc_model.vehicle import load_vehicle

DEG = np.pi / 180.0
DT = 0.004
BEGIN = 1250  # the sample at which faults begin


class Hover:
    """A level vehicle at rest, diagnosed."""

    def __init__(self, parameters, driven=True):
        self.driven = driven
        self.law, self.rng = (
            Isolating(vehicle=load_vehicle("qball_x4"), **parameters),
            np.random.default_rng(1),
        )
        self.state, self.estimates = None, []

    def on(self, count, change=lambda index, sample: sample):
        samples = [change(index, self.measured()) for index in range(count)]
        inputs = [FaultObserverInputs(each, np.zeros(3), driven=np.bool_(self.driven)) for each in samples]
        self.state, flown = fly_law(*as_flown(self.law, inputs), DT, self.state)
        self.estimates += [each.said for each in flown]
        return self

    def measured(self):
        return level_sample()._replace(
            q_xyzw=quaternion_from_euler(0.1 * DEG * self.rng.standard_normal(3)),
            body_rate=0.002 * self.rng.standard_normal(3),
            specific_force=np.array([0.0, 0.0, 9.80665]) + 0.02 * self.rng.standard_normal(3),
        )


@functools.cache
def until_faults_begin(**parameters):
    return Hover(parameters).on(BEGIN)


def hover(count, change=lambda index, sample: sample, **parameters):
    """Estimates of ``count`` samples; ``change`` puts faults on them from `BEGIN` on."""
    flown = copy.copy(until_faults_begin(**parameters))
    flown.rng, flown.estimates = copy.deepcopy(flown.rng), [*flown.estimates]
    return flown.on(count - BEGIN, change).estimates


def shifted(channel, offset):
    """A fault that adds ``offset(elapsed time)`` to a channel."""

    def change(index, sample):
        return sample._replace(**{channel: getattr(sample, channel) + offset(index * DT)})

    return change


def turned(angles):
    """A fault that adds ``angles(elapsed time)`` to the attitude."""

    def change(index, sample):
        euler = euler_from_quaternion(sample.q_xyzw) + angles(index * DT)
        return sample._replace(q_xyzw=quaternion_from_euler(euler))

    return change


def states(estimate):
    """Fault states of attitude, gyro and accelerometer."""
    return [part.state.tolist() for part in estimate.sensors]


def test_a_healthy_vehicle_has_healthy_sensors():
    for estimate in hover(1500)[500:]:
        assert max(np.max(part.state) for part in estimate.sensors) <= 2  # suspicions come and go
        assert not estimate.sensors.gyro.ambiguous.any()


def carried(index, sample):
    """A sample of a vehicle in a hand, which waves and rests, with a gyro that repeats itself at rest."""
    phase, moves = 6.0 * np.pi * index * DT, float(index % 1000 < 500)
    angle, rate = 0.1 * moves * (1.0 - np.cos(phase)), 0.6 * np.pi * moves * np.sin(phase)
    x = np.array([1.0, 0.0, 0.0])
    return turned(lambda _: angle * x)(index, sample)._replace(
        body_rate=np.round(sample.body_rate / 4.0 + rate * x, 3),
        specific_force=sample.specific_force + 3.0 * moves * np.sin(phase) * x,
    )


def test_without_a_known_torque_motion_is_no_fault():
    assert all(
        np.max(part.state) <= SUSPECT
        for each in Hover({}, driven=False).on(3000, carried).estimates[500:]
        for part in each.sensors
    )


@pytest.mark.parametrize("telling", [True, False])
def test_a_gyro_that_needs_an_acceleration_is_guilty_if_the_torque_and_the_attitude_tell(telling):
    yes, zero = np.array([True]), np.zeros(1)
    seen = hypotheses.Evidence(
        *(~yes, ~yes, zero, zero, zero, zero, zero, zero, zero + 6.0, zero, zero), telling=np.array([telling])
    )
    state, guilty = hypotheses.start_hypotheses(~yes), []
    for index in range(100):
        state, named = hypotheses.weigh(state, yes, yes & (index == 0), zero + 0.05, seen, DT)
        guilty.append(named[0])
    assert any(guilty) == telling
    assert telling or state.ambiguous[0]


def test_without_a_known_torque_a_gyro_that_is_off_is_ambiguous():
    off = shifted("body_rate", lambda _: np.array([0.3, 0.0, 0.0]))
    last = Hover({}, driven=False).on(BEGIN).on(250, off).estimates[-1]
    assert (
        last.sensors.gyro.ambiguous.tolist()
        == last.sensors.attitude.ambiguous.tolist()
        == [True, False, False]
    )


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("size", [-0.15, 0.4])
def test_a_step_of_the_gyro_is_named_in_three_samples(axis, size):
    step = size * np.eye(3)[axis]
    estimates = hover(BEGIN + 250, shifted("body_rate", lambda _: step))
    named = [np.flatnonzero(each.sensors.gyro.state == FAULTY).tolist() for each in estimates]
    assert named[BEGIN + 1 : BEGIN + 3] == [[], [axis]]
    last = estimates[-1]
    assert last.sensors.gyro.size[axis] == pytest.approx(size, abs=0.05)
    assert last.sensors.gyro.kind[axis] == FAULT_KINDS.index("offset")
    assert last.sensors.attitude.state.tolist() == [HEALTHY] * 3
    # the controller flies on a rate without the fault
    rates = np.array([each.corrected.body_rate[axis] for each in estimates[BEGIN:]])
    assert np.max(np.abs(rates)) < 0.08
    assert abs(np.mean(rates)) < 0.01


def test_a_stuck_gyro_is_named_by_its_repetition():
    stuck = np.array([0.001, 0.002, -0.001])
    last = hover(BEGIN + 50, lambda _, sample: sample._replace(body_rate=stuck))[-1]
    assert last.sensors.gyro.state.tolist() == [FAULTY] * 3
    assert last.sensors.gyro.kind.tolist() == [FAULT_KINDS.index("stuck")] * 3


def test_a_gyro_that_sticks_for_two_samples_and_is_off_then_is_named():
    held, off = np.array([0.001, 0.002, -0.001]), np.array([0.0, 0.3, 0.0])

    def change(index, sample):
        return sample._replace(body_rate=held if index < 3 else sample.body_rate + off)

    last = hover(BEGIN + 8, change)[-1]
    assert states(last)[:2] == [[HEALTHY] * 3, [HEALTHY, FAULTY, HEALTHY]]
    assert last.sensors.gyro.size[1] == pytest.approx(0.3, abs=0.05)


def test_a_saturated_gyro_is_named_as_stuck():
    def change(_, sample):
        return sample._replace(body_rate=np.array([0.0, 0.0, 0.02]) + sample.body_rate * [1.0, 1.0, 0.0])

    last = hover(BEGIN + 50, change)[-1]
    assert last.sensors.gyro.state.tolist() == [HEALTHY, HEALTHY, FAULTY]
    assert last.sensors.gyro.kind[2] == FAULT_KINDS.index("stuck")


def test_an_absent_gyro_is_replaced():
    def absent(_, sample):
        return sample._replace(body_rate=np.zeros(3), rate_valid=np.bool_(False))

    estimates = hover(BEGIN + 100, absent)
    assert all(estimate.corrected.rate_valid for estimate in estimates)
    assert estimates[-1].sensors.gyro.kind.tolist() == [FAULT_KINDS.index("absent")] * 3


def test_an_absent_attitude_is_named():
    def absent(_, sample):
        return sample._replace(attitude_valid=np.bool_(False))

    last = hover(BEGIN + 10, absent)[-1]
    assert states(last)[:2] == [[FAULTY] * 3, [HEALTHY] * 3]
    assert last.sensors.attitude.kind.tolist() == [FAULT_KINDS.index("absent")] * 3


def test_nothing_overflows_while_attitude_and_gyro_are_absent():
    def absent(_, sample):
        nothing = np.bool_(False)
        return sample._replace(body_rate=np.zeros(3), rate_valid=nothing, attitude_valid=nothing)

    last = hover(BEGIN + 7500, absent)[-1]
    assert np.all(np.isfinite(last.std_dev))
    assert np.all(np.abs(last.corrected.body_rate) < 1.0)


def test_a_gyro_is_better_than_a_virtual_one_that_has_drifted_away():
    def alone(index, sample):
        """Without an attitude: a step of the gyro for 0.2 s, and then the vehicle turns indeed."""
        rate = np.array([0.5 if 250 <= index < 300 else 0.3 * (index >= 300), 0.0, 0.0])
        return sample._replace(attitude_valid=np.False_, body_rate=sample.body_rate + rate)

    estimates = hover(BEGIN + 4000, alone)
    assert states(estimates[BEGIN + 310])[1][0] == FAULTY
    assert states(estimates[-1])[1] == [HEALTHY] * 3
    assert estimates[-1].corrected.body_rate[0] == pytest.approx(0.3, abs=0.02)


def test_a_gyro_that_is_healthy_again_is_trusted():
    def passing(time):
        return np.array([0.3, 0.0, 0.0]) * (time < 1.0)

    estimates = hover(BEGIN + 700, shifted("body_rate", passing))
    assert estimates[BEGIN + 249].sensors.gyro.state[0] == FAULTY
    assert estimates[-1].sensors.gyro.state[0] == HEALTHY


@pytest.mark.parametrize("size", [0.033, 0.06])
def test_a_gyro_that_is_slightly_off_is_named_until_it_reads_right_again(size):
    def passing(time):
        return np.array([size, 0.0, 0.0]) * (time < 6.0)

    estimates = hover(BEGIN + 2250, shifted("body_rate", passing))
    assert all(each.sensors.gyro.state[0] in ALARMS for each in estimates[BEGIN + 3 : BEGIN + 1500])
    assert states(estimates[-1])[:2] == [[HEALTHY] * 3] * 2


@pytest.mark.parametrize(("size", "state"), [(1.0, SUSPECT), (3.0, FAULTY)])
def test_a_small_fault_of_the_attitude_right_after_the_gyros_is_what_that_one_did(size, state):
    def change(index, sample):
        sample = shifted("body_rate", lambda _: np.array([0.3, 0.0, 0.0]))(index, sample)
        return turned(lambda time: np.array([size * DEG * (time > 0.1), 0.0, 0.0]))(index, sample)

    estimates = hover(BEGIN + 50, change)
    assert max(states(each)[0][0] for each in estimates[BEGIN:]) == state
    assert states(estimates[-1])[1] == [FAULTY, HEALTHY, HEALTHY]


@pytest.mark.parametrize(("sigma", "seed"), [(0.5, 5), (0.5, 15), (0.66, 12)])
def test_what_a_noisy_attitude_has_made_of_the_rate_is_forgotten_once_it_is_named(sigma, seed):
    noise = np.random.default_rng(seed)
    estimates = hover(
        BEGIN + 150, turned(lambda _: np.array([0.0, sigma * DEG * noise.standard_normal(), 0.0]))
    )
    for gyro in (each.sensors.gyro for each in estimates[BEGIN:]):
        assert not np.any((gyro.state == FAULTY) & ~gyro.ambiguous)
    assert estimates[-1].sensors.attitude.state[1] == FAULTY


def test_a_jump_of_the_attitude_is_the_attitudes():
    last = hover(BEGIN + 250, turned(lambda _: np.array([0.0, 3.0 * DEG, 0.0])))[-1]
    assert states(last)[:2] == [[HEALTHY, FAULTY, HEALTHY], [HEALTHY] * 3]
    assert last.sensors.attitude.probability[1] == 1.0
    assert last.sensors.attitude.size[1] == pytest.approx(3.0 * DEG, abs=0.2 * DEG)


def test_a_slow_ramp_is_ambiguous():
    last = hover(BEGIN + 750, turned(lambda time: np.array([0.0, 0.0, 0.5 * DEG * time])))[-1]
    attitude, gyro, _ = last.sensors
    assert attitude.ambiguous.tolist() == gyro.ambiguous.tolist() == [False, False, True]
    assert 0.0 < gyro.probability[2] < 1.0
    assert attitude.probability[2] + gyro.probability[2] == pytest.approx(1.0)
    # flown on the gyro, as the discrepancy is small
    assert abs(euler_from_quaternion(last.corrected.q_xyzw)[2]) < 0.3 * DEG


def test_an_ambiguous_error_is_bounded_however_long_the_fault_lasts():
    """The attitude is right and the gyro drifts: the controller never gets more than the belief too much."""
    drift = np.array([0.03, 0.0, 0.0])
    estimates = hover(BEGIN + 2250, shifted("body_rate", lambda time: drift * time))
    rolls = [euler_from_quaternion(each.corrected.q_xyzw)[0] for each in estimates[BEGIN:]]
    assert np.max(np.abs(rolls)) < 5.5 * DEG


def test_a_fast_drift_of_the_gyro_is_named_in_the_end():
    drift = np.array([0.0, 0.3, 0.0])
    last = hover(BEGIN + 500, shifted("body_rate", lambda time: drift * time))[-1]
    assert (states(last)[0][1], states(last)[1][1]) == (HEALTHY, FAULTY)
    assert not last.sensors.gyro.ambiguous[1]


@pytest.mark.parametrize("size", [1.0, -2.0])
def test_an_offset_of_the_accelerometer_is_named(size):
    last = hover(BEGIN + 100, shifted("specific_force", lambda _: np.array([size, 0.0, 0.0])))[-1]
    assert states(last) == [[HEALTHY] * 3, [HEALTHY] * 3, [FAULTY, HEALTHY, HEALTHY]]
    assert last.sensors.accelerometer.size[0] == pytest.approx(size, abs=0.1)


def test_an_attitude_of_the_same_gyro_is_no_witness():
    step = np.array([0.3, 0.0, 0.0])
    last = hover(BEGIN + 50, shifted("body_rate", lambda _: step), attitude_from_gyro=True)[-1]
    assert last.sensors.gyro.state[0] == FAULTY
    assert last.sensors.attitude.ambiguous.tolist() == [True, False, False]


def test_the_belief_in_the_gyros_guilt_grows_with_the_rate():
    odds = hypotheses.belief_in_gyro(np.array([0.05, 0.1, 0.2, 0.25]))
    assert np.all(np.diff(odds) > 0.0)
    assert odds[0] < 0.0 < odds[2]
    assert odds[2] == pytest.approx(hypotheses.NAMED, abs=0.1)  # 95 % at 0.2 rad/s


@pytest.mark.parametrize(
    ("fault", "shift", "share"), [(3.0, 0.0, 0.0), (-5.75, -0.75, 0.5), (20.0, 15.0, 1.0)]
)
def test_what_is_flown_keeps_its_distance_from_the_attitude(fault, shift, share):
    axes, one = np.array([fault * DEG, 0.0, 0.0]), np.array([True, False, False])
    result = hypotheses.flown(axes, one, 5.0 * DEG)
    np.testing.assert_allclose(result[0], [shift * DEG, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(result[1], [share, 0.0, 0.0], atol=1e-12)


def test_the_virtual_gyro_follows_a_torque_as_well_as_it_says():
    """Rate by attitude and torque alone, while the vehicle oscillates: errors within the variance."""
    rng, dt, wave = np.random.default_rng(2), DT, 3.0
    zeros, noise = np.zeros(3), 0.1 * DEG
    q_xyzw, state = np.array([0.0, 0.0, 0.0, 1.0]), rate_filter.start_rate_filter(zeros, zeros, noise**2)
    errors, claimed = [], []
    for index in range(1, 2500):
        time = index * dt
        angles = np.array([0.1 * np.sin(wave * time), 0.0, 0.0])
        drive = np.array([-0.1 * wave**2 * np.sin(wave * (time - 0.5 * dt)), 0.0, 0.0])
        state, turned = rate_filter.predict(state, drive, zeros, np.ones(3), dt)
        q_xyzw = turn(q_xyzw, turned)
        measured = quaternion_from_euler(angles + noise * rng.standard_normal(3))
        rotation = rate_filter.rotation_to(q_xyzw, measured)
        used = np.ones(3, dtype=bool)
        state, corrected = rate_filter.correct_by_attitude(state, rotation, zeros + noise**2, used)
        q_xyzw = turn(q_xyzw, corrected)
        if index > 500:
            errors.append(state.rate - [0.1 * wave * np.cos(wave * time), 0.0, 0.0])
            claimed.append(state.rr)
    assert np.sqrt(np.mean(np.square(errors))) < np.sqrt(np.mean(claimed)) < 0.03
