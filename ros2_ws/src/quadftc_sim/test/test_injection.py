"""Fault injection: when, where, and the truth that is told of it."""

import math

import numpy as np
import pytest

from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import ImuSample
from quadftc_sim.fault import faults
from quadftc_sim.injection import AXES, CHANNEL_UNITS, make_injection
from quadftc_sim.injector import FaultInjector

EPOCH = 1_000_000_000  # ns
ANGLES, RATE, FORCE = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.5, -0.6]), np.array([0.7, 0.8, 9.8])
TRUE = np.bool_(True)
SIZE = {
    "value": 0.1,
    "rate": 0.1,
    "amplitude": 0.1,
    "factor": 0.1,
    "sigma": 0.1,
    "probability": 0.5,
    "limit": 0.1,
}
ATTRIBUTES = {"attitude": "attitude", "gyro": "gyro", "accelerometer": "accelerometer"}
# every fault on every channel where it can be
PAIRS = [
    (kind, channel)
    for kind in faults.names()
    for channel in ATTRIBUTES
    if channel in faults.get(kind).channels
]


def healthy(index=0):
    """A moving vehicle's sample."""
    turn = 0.001 * index
    return ImuSample(quaternion_from_euler(ANGLES + turn), RATE + turn, FORCE + turn, TRUE, TRUE, TRUE)


def injector(*injections, seed=0):
    made = FaultInjector(seed)
    for kind, values in injections:
        made.add(make_injection(kind, values))
    return made


def flown(made, count=20, rate=250, first=0):
    """What comes out for samples ``first`` to ``first + count`` at a rate [Hz]."""
    period = round(1e9 / rate)
    return [made.apply(EPOCH + index * period, healthy(index)) for index in range(first, first + count)]


def truth(results, channel="attitude"):
    return np.array([getattr(result, channel) for result in results])


def channel_of(sample, channel):
    """The three numbers of a channel."""
    if channel == "attitude":
        return euler_from_quaternion(sample.q_xyzw)
    return sample.body_rate if channel == "gyro" else sample.specific_force


def sized(kind, **values):
    """Values that give a fault a size."""
    own = {name for name in SIZE if name in faults.get(kind).__dataclass_fields__}
    return kind, {**{name: SIZE[name] for name in own}, **values}


def test_nothing_injected_leaves_the_sample_as_it_is():
    sample = healthy()
    result = FaultInjector().apply(EPOCH, sample)
    assert result.sample is sample
    assert not np.any([result.attitude, result.gyro, result.accelerometer])


@pytest.mark.parametrize("rate", [250, 300])
@pytest.mark.parametrize(("start", "stop"), [(0.0, 0.02), (0.02, 0.05), (0.1, 0.3), (0.041, 0.0437)])
def test_window_holds_to_the_sample_start_inclusive_stop_exclusive(rate, start, stop):
    made = injector(("bias", {"value": 1.0, "channel": "gyro", "start": start, "stop": stop}))
    active = [bool(np.any(row)) for row in truth(flown(made, 100, rate), "gyro")]
    period = round(1e9 / rate)
    assert active == [round(start * 1e9) <= index * period < round(stop * 1e9) for index in range(100)]


def test_duration_ends_at_the_sample_of_the_sum():
    made = injector(("bias", {"value": 1.0, "channel": "gyro", "start": 0.1, "duration": 0.2}))
    active = np.flatnonzero(np.any(truth(flown(made, 100), "gyro"), axis=-1))
    assert (active[0], active[-1]) == (25, 74)


def test_injection_at_run_time_counts_from_the_last_sample():
    made = FaultInjector()
    flown(made, 7)  # the last one at 0.024 s
    made.add(
        make_injection("bias", {"value": 1.0, "channel": "gyro", "start": 0.08, "duration": 0.02}, made.now)
    )
    active = np.flatnonzero(np.any(truth(flown(made, 40, first=7), "gyro"), axis=-1)) + 7
    assert (active[0], active[-1]) == (26, 30)  # 0.104 s to 0.120 s


def test_injection_without_times_acts_from_the_next_sample_on():
    made = FaultInjector()
    flown(made, 5)
    made.add(make_injection("bias", {"value": 1.0, "channel": "gyro"}, made.now))
    assert np.all(truth(flown(made, 20, first=5), "gyro") != 0.0)


def test_elapsed_time_counts_from_the_onset():
    made = injector(("drift", {"rate": 1.0, "channel": "gyro", "start": 0.02}))
    expected = np.maximum(0.004 * np.arange(20) - 0.02, 0.0)
    np.testing.assert_allclose(truth(flown(made), "gyro")[:, 0], expected, atol=1e-14)


@pytest.mark.parametrize(("kind", "channel"), [each for each in PAIRS if each[0] != "nan"])
def test_truth_is_the_faulty_minus_the_healthy_channel(kind, channel):
    for index, result in enumerate(flown(injector(sized(kind, channel=channel)))):
        difference = channel_of(result.sample, channel) - channel_of(healthy(index), channel)
        expected = wrap(difference) if channel == "attitude" else difference
        np.testing.assert_allclose(getattr(result, channel), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("kind", "channel"), [each for each in PAIRS if not faults.get(each[0]).whole_channel]
)
def test_other_axes_and_channels_are_left_alone(kind, channel):
    results = flown(injector(sized(kind, channel=channel, axes=["y"])))
    for name in ATTRIBUTES:
        np.testing.assert_allclose(truth(results, name)[:, [0, 2]], 0.0, atol=1e-14)
        assert name == channel or not np.any(truth(results, name))


@pytest.mark.parametrize(("axis", "index"), AXES.items())
def test_axis_names_select_their_component(axis, index):
    made = injector(("bias", {"value": 1.0, "channel": "gyro", "axes": axis}))
    assert np.flatnonzero(flown(made, 1)[0].gyro).tolist() == [index]


def test_yaw_fault_over_half_a_turn_is_told_as_the_short_way():
    made = injector(("bias", {"value": "350 deg", "axes": "yaw"}))
    assert truth(flown(made, 1))[0, 2] == pytest.approx(math.radians(-10.0))


def test_nan_is_told_on_its_axes_only():
    result = flown(injector(("nan", {"channel": "gyro", "axes": ["x", "z"]})), 1)[0]
    assert np.isnan(result.gyro).tolist() == [True, False, True]
    assert np.isnan(result.sample.body_rate).tolist() == [True, False, True]


def test_faults_on_one_channel_act_one_on_the_other():
    made = injector(sized("bias", value=0.5, channel="gyro"), sized("scale", factor=-0.5, channel="gyro"))
    expected = 0.5 * (RATE + 0.5)
    np.testing.assert_allclose(flown(made, 1)[0].sample.body_rate, expected, rtol=1e-14)


def test_faults_on_several_axes_at_once_add_up():
    made = injector(
        ("bias", {"value": 0.1, "axes": "roll"}), ("drift", {"rate": 1.0}), ("sine", {"amplitude": 0.2})
    )
    times = 0.004 * np.arange(20)
    expected = (times + 0.2 * np.sin(times))[:, None] + np.array([0.1, 0.0, 0.0])
    np.testing.assert_allclose(truth(flown(made)), expected, atol=1e-14)


def test_stuck_channel_is_stuck_at_the_onset_in_the_course_of_a_flight():
    results = flown(injector(("stuck", {"channel": "gyro", "start": 0.02, "stop": 0.06})))
    expected = np.array([healthy(5 if 5 <= index < 15 else index).body_rate for index in range(20)])
    np.testing.assert_array_equal([result.sample.body_rate for result in results], expected)


def test_delay_from_its_onset_on_gives_what_was_before_it():
    results = flown(injector(("delay", {"delay": 0.012, "channel": "gyro", "start": 0.02})))
    expected = np.array([healthy(index - 3 if index >= 5 else index).body_rate for index in range(20)])
    np.testing.assert_array_equal([result.sample.body_rate for result in results], expected)


def test_channel_that_one_fault_drops_is_not_brought_back_by_another():
    never, always = ("dropout", {"channel": "gyro", "probability": 0.0}), ("dropout", {"channel": "gyro"})
    assert not flown(injector(always, never), 1)[0].sample.rate_valid


def test_dropout_of_the_imu_withholds_the_sample():
    results = flown(injector(("dropout", {"channel": "imu", "start": 0.02, "stop": 0.04})))
    assert [not result.present for result in results] == [5 <= index < 10 for index in range(20)]


@pytest.mark.parametrize(
    ("channel", "flag"),
    [("attitude", "attitude_valid"), ("gyro", "rate_valid"), ("accelerometer", "force_valid")],
)
def test_dropout_of_a_channel_marks_it_absent(channel, flag):
    sample = flown(injector(("dropout", {"channel": channel})), 1)[0].sample
    flags = ("attitude_valid", "rate_valid", "force_valid")
    assert [name for name in flags if not getattr(sample, name)] == [flag]


@pytest.mark.parametrize("kind", [name for name in faults.names() if faults.get(name).is_random])
def test_random_fault_is_the_same_whatever_else_is_injected(kind):
    values = sized(kind, channel="gyro", start=0.008)
    alone = truth(flown(injector(values, seed=3)), "gyro")
    other = injector(values, sized("noise"), sized("dropout", channel="imu", probability=0.0), seed=3)
    results = flown(other, 10)
    other.clear(2)
    other.add(make_injection("spikes", {"amplitude": 1.0, "rate": 100.0}, other.now))
    results += flown(other, 10, first=10)
    np.testing.assert_array_equal(truth(results, "gyro"), alone)


def test_random_faults_of_two_injections_and_two_seeds_differ():
    noise = sized("noise", channel="gyro"), sized("noise", channel="accelerometer")
    first, second = flown(injector(*noise, seed=3)), flown(injector(*noise, seed=4))
    columns = np.concatenate(
        [truth(first, "gyro"), truth(first, "accelerometer"), truth(second, "gyro")], axis=-1
    )
    assert len(np.unique(columns)) == columns.size


def test_clear_ends_one_injection_and_zero_ends_all():
    made = injector(*[("bias", {"value": 1.0, "channel": "gyro"})] * 3)
    assert (made.clear(2), made.clear(2), made.clear(77)) == (1, 0, 0)
    assert flown(made, 1)[0].gyro.tolist() == [2.0, 2.0, 2.0]
    assert made.clear() == 2
    assert flown(made, 1, first=1)[0].gyro.tolist() == [0.0, 0.0, 0.0]


def test_injections_wait_act_and_are_forgotten():
    made = injector(("bias", {"value": 1.0, "start": 0.02, "stop": 0.04}))
    flown(made, 3)
    assert (list(made.injections), list(made.active)) == ([1], [])
    flown(made, 5, first=3)
    assert (list(made.injections), list(made.active)) == ([1], [1])
    flown(made, 5, first=8)
    assert (list(made.injections), list(made.active)) == ([], [])


@pytest.mark.parametrize("channel", ATTRIBUTES)
def test_injection_that_waits_leaves_the_sample_as_it_is_bit_for_bit(channel):
    made = injector(("bias", {"value": 1.0, "channel": channel, "start": 5.0}))
    for before, after in zip(healthy(), flown(made, 1)[0].sample, strict=True):
        assert np.array_equal(before, after)


def test_channel_that_is_absent_stays_absent():
    made = injector(("bias", {"value": 1.0, "channel": "gyro"}))
    result = made.apply(EPOCH, healthy()._replace(rate_valid=np.bool_(False)))
    assert not result.sample.rate_valid


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        ("bais", {}, r"no fault 'bais' \(did you mean 'bias'\?\); there are: bias, delay"),
        (
            "bias",
            {"channel": "magnetometer"},
            r"channel = 'magnetometer': expected one of attitude, gyro, acc",
        ),
        ("bias", {"channel": "imu"}, r"channel = 'imu': bias can be on attitude, gyro, accelerometer"),
        ("bias", {"axes": ["rol"]}, r"axes: 'rol' is no axis; expected roll, pitch, yaw or x, y, z"),
        ("bias", {"axes": 3}, r"axes: 3 is no axis"),
        ("bias", {"axes": [["x"]]}, r"axes: \['x'\] is no axis"),
        ("bias", {"axes": ["x"], "axis": "y"}, r"axes: given twice, as axis too"),
        ("dropout", {"axes": ["x"]}, r"axes = x: dropout takes the whole channel; leave axes out"),
        ("bias", {"start": -1}, r"start = -1 s: must not be negative"),
        ("bias", {"start": 1e300}, r"start = 1e\+300 s: must be at most 9.2e\+09 s, where stamps end"),
        ("bias", {"start": "inf"}, r"start"),
        ("bias", {"duration": 1e300}, r"duration = 1e\+300 s: must be at most 9.2e\+09 s"),
        ("bias", {"start": "soon"}, r"start: 'soon': expected a number in s"),
        ("bias", {"start": None}, r"start: None: expected a number in s"),
        ("bias", {"start": "1 m"}, r"start: '1 m': 'm' is not a unit of this quantity; expected s, ms, min"),
        ("bias", {"start": 2, "stop": 2}, r"stop = 2 s: must be later than start = 2 s"),
        ("bias", {"start": 2, "stop": 1}, r"stop = 1 s: must be later than start = 2 s"),
        ("bias", {"duration": -1}, r"duration = -1 s: must not be negative"),
        ("bias", {"duration": 0}, r"duration = 0 s: must be positive"),
        ("bias", {"duration": 1e-12}, r"duration = 1e-12 s: must be positive"),
        ("bias", {"duration": 1, "stop": 3}, r"duration: give either duration or stop"),
        ("bias", {"offset": 1}, r"offset: unknown parameter; known: value"),
        (
            "bias",
            {"value": "1 m/s^2"},
            r"value: '1 m/s\^2': 'm/s\^2' is not a unit of this quantity; expected rad",
        ),
        (
            "bias",
            {"value": "1 deg", "channel": "gyro"},
            r"value: '1 deg': 'deg' is not a unit .*; expected rad/s",
        ),
        ("bias", {"value": "inf"}, r"value = inf rad: must be finite"),
        ("noise", {"sigma": -1}, r"sigma = -1.0 rad: must be within \[0, inf\]"),
        ("dropout", {"probability": 1.5}, r"probability = 1.5: must be within \[0, 1\]"),
        ("delay", {"delay": "2 s"}, r"delay = 2.0 s: must be within \[0, 1\]"),
    ],
)
def test_injection_that_cannot_be_done_is_refused_with_the_reason(kind, values, message):
    with pytest.raises(ValueError, match=message):
        make_injection(kind, values)


@pytest.mark.parametrize("channel", ATTRIBUTES)
def test_sizes_are_in_the_unit_of_the_channel(channel):
    unit = CHANNEL_UNITS[channel]["channel"]
    made = injector(("bias", {"value": f"0.5 {unit}", "channel": channel, "axes": "x"}))
    assert getattr(flown(made, 1)[0], channel)[0] == pytest.approx(0.5)
