"""The flight manager: what is flown on and what is kept, input by input, without ROS."""

from __future__ import annotations

import numpy as np
import pytest

from quadftc_control.controller import controllers
from quadftc_control.flight_manager import FlightManager
from quadftc_control.input_monitor import Mode, Patience
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import AttitudeCommand, AttitudeReference, level_sample
from quadftc_model.vehicle import load_vehicle

PERIOD_NS = 4_000_000
FAULT = np.array([0.05, 0.0, 0.0])
BIAS = np.array([0.0, 0.01, 0.0])


class Reader:
    """Messages as Python objects: a sample for imu/data, a list [fault] for fault/status."""

    def __init__(self, state=1):
        self.state = state

    def imu(self, data):
        return data

    def states(self, data):
        return (self.state,) * 3

    def status(self, data):
        return list(data)

    def faulty_part(self, status):
        return status[0]

    def revise(self, status, stamp_ns, fault, certain):
        status[0] = fault


def wanted(size, thrust=-1.0):
    """A command of angles, rates and accelerations of a size."""
    return AttitudeCommand(AttitudeReference(*np.full((3, 3), size)), np.float64(thrust))


class Flight:
    """A manager with samples to feed it; imu/data is off by a fault and a gyro bias."""

    def __init__(self, flies=False, **patience):
        law = controllers.get("ismc")(vehicle=load_vehicle("qball_x4"))
        self.counted = []
        self.manager = FlightManager(law, Patience(**patience), Reader(), self.counted.append, flies)
        self.stamp_ns = 0
        self.healthy = level_sample()
        self.raw = level_sample()._replace(q_xyzw=quaternion_from_euler(FAULT), body_rate=BIAS)

    def next(self, corrected=True, disturbance=True):
        """Feed one sample; return the command, or None."""
        manager = self.manager
        self.stamp_ns += PERIOD_NS
        manager.take_reference(self.stamp_ns, wanted(0.0, 10.0))
        manager.take_status(self.stamp_ns, [FAULT])
        if disturbance:
            manager.take_disturbance(self.stamp_ns, np.array([1.0, 2.0, 3.0]))
        command = manager.take_raw(self.stamp_ns, self.raw) if self._needs_raw() else None
        return (corrected and manager.take_corrected(self.stamp_ns, self.healthy)) or command

    def _needs_raw(self):
        return self.manager.needs_raw(self.stamp_ns, self.raw)


def torques(second=None, first="ismc"):
    """Torques [N m] off the reference, before and after another controller takes over, or none."""
    flight, vehicle = Flight(), load_vehicle("qball_x4")
    flight.healthy = level_sample()._replace(q_xyzw=quaternion_from_euler(FAULT), body_rate=BIAS)
    flight.manager.configure(controllers.get(first)(vehicle=vehicle), Patience())
    found = [flight.next().output.torque for _ in range(300)]
    assert flight.manager.must_keep() == ""
    if second:
        flight.manager.configure(controllers.get(second)(vehicle=vehicle), Patience())
    return np.array(found + [flight.next().output.torque for _ in range(300)])


@pytest.mark.parametrize(("first", "second"), [("ismc", "pid"), ("pid", "indi"), ("smc", "ismc")])
def test_controller_that_takes_over_in_flight_does_not_make_the_torque_jump(first, second):
    alone, found = torques(None, first), torques(second, first)
    np.testing.assert_array_equal(found[:300], alone[:300])
    np.testing.assert_allclose(found[300], alone[300], atol=1e-12)
    authority = load_vehicle("qball_x4").authority
    assert np.max(np.abs(np.diff(found[299:], axis=0)) / authority) < 0.01
    assert np.max(np.abs(found[-1] - alone[-1])) > 1e-3  # it is another law


@pytest.fixture
def flight():
    started = Flight()
    for _ in range(30):
        assert started.next().mode is Mode.FULL
    return started


def test_third_sample_without_corrected_imu_is_flown_on_the_raw_one(flight):
    modes = [command and command.mode for command in (flight.next(corrected=False) for _ in range(4))]
    assert modes == [None, None, Mode.NO_DIAGNOSIS, Mode.NO_DIAGNOSIS]


def test_lost_diagnosis_is_kept_with_gyro_bias_and_fault_and_the_fault_is_taken_off(flight):
    for _ in range(3):
        command = flight.next(corrected=False)
    gyro, fault = flight.manager.kept
    assert (gyro[:2], fault[:2]) == (("gyro", 30 * PERIOD_NS), ("fault", 30 * PERIOD_NS))
    np.testing.assert_allclose(gyro[2], -BIAS)
    assert np.max(np.abs(command.output.error)) < 1e-3  # not 0.05 rad, the fault of imu/data


def test_gyro_bias_is_kept_as_the_observer_tells_it_if_it_does(flight):
    flight.manager.take_bias(30 * PERIOD_NS, np.full(3, np.nan))
    flight.manager.take_bias(20 * PERIOD_NS, 2.0 * BIAS)
    for _ in range(3):
        flight.next(corrected=False)
    np.testing.assert_allclose(flight.manager.kept[0][2], -2.0 * BIAS)


def test_while_the_fault_is_taken_off_its_size_is_published_twenty_times_a_second(flight):
    for _ in range(3):
        flight.next(corrected=False)
    flight.manager.kept.clear()
    for _ in range(50):  # 0.2 s
        flight.next(corrected=False)
    assert [kept[0] for kept in flight.manager.kept] in (["fault"] * 3, ["fault"] * 4)
    np.testing.assert_allclose(flight.manager.kept[-1][2][0], FAULT, atol=1e-3)


def test_observer_that_came_back_without_the_last_words_is_waited_for(flight):
    """It believes the faulty attitude at first. The words come later; until then the fault is taken off."""
    for _ in range(100):
        flight.next(corrected=False)
    healthy, flight.healthy = flight.healthy, flight.raw
    for _ in range(200):  # 0.8 s
        assert flight.next().mode is Mode.NO_DIAGNOSIS
    flight.healthy = healthy
    assert [flight.next().mode for _ in range(2)][-1] is Mode.FULL


def test_observer_that_contradicts_for_long_is_believed(flight):
    for _ in range(100):
        flight.next(corrected=False)
    flight.healthy = flight.raw
    modes = [flight.next().mode for _ in range(850)]  # 3.4 s
    assert modes[700] is Mode.NO_DIAGNOSIS
    assert modes[-1] is Mode.FULL


def test_old_disturbance_estimate_is_kept_once_and_the_mode_says_so(flight):
    modes = {flight.next(disturbance=False).mode for _ in range(20)}
    assert modes == {Mode.FULL, Mode.NO_DISTURBANCE_ESTIMATE}
    ((what, stamp_ns, estimate),) = flight.manager.kept
    assert (what, stamp_ns) == ("disturbance", 30 * PERIOD_NS)
    np.testing.assert_array_equal(estimate, [1.0, 2.0, 3.0])


def test_silence_holds_the_torque_then_commands_zero(flight):
    flight.manager.watch(0)
    assert flight.manager.watch(50_000_000) is None
    assert flight.manager.watch(200_000_000).mode is Mode.HOLD
    off = flight.manager.watch(600_000_000)
    assert off.mode is Mode.OFF
    assert not off.output.torque.any()
    assert flight.next().mode is Mode.OFF  # one sample is not enough to fly again


@pytest.mark.parametrize("size", [np.nan, np.inf, 2e6])
def test_unusable_inputs_are_counted_and_not_used(flight, size):
    before = flight.manager.wanted
    assert flight.manager.take_reference(0, wanted(size)) is before
    assert flight.manager.take_reference(0, wanted(0.0, size)) is before
    assert not flight.manager.take_disturbance(0, np.full(3, size)).any()
    assert len(flight.counted) == 3


def test_rotor_speeds_are_flown_on_while_they_are_fresh_and_finite():
    flight = Flight(flies=True)
    manager, step, seen = flight.manager, flight.manager._stepper.step, []

    def noted(stamp_ns, inputs):
        seen.append(inputs)
        return step(stamp_ns, inputs)

    manager._stepper.step = noted
    spinning = np.array([400.0, 400.0, 410.0, 390.0])
    for measured in (None, spinning, np.full(4, np.nan), *[None] * 30):
        if measured is not None:
            manager.take_speeds(flight.stamp_ns + PERIOD_NS, measured)
        flight.next()
    assert not seen[0].measured
    assert all(each.measured and np.array_equal(each.speeds, spinning) for each in seen[1:20])
    assert not seen[-1].measured  # 0.12 s later
    assert flight.counted == ["rotors/speed: not finite"]


def test_in_free_flight_rotors_hold_the_thrust_in_silence_and_stop_at_its_end():
    flight, vehicle = Flight(flies=True), load_vehicle("qball_x4")
    for _ in range(30):
        command = flight.next()
    np.testing.assert_allclose(vehicle.rotors.thrust_coefficient * np.sum(command.speeds**2), 10.0)
    flight.manager.watch(0)
    held = flight.manager.watch(200_000_000)
    np.testing.assert_allclose(vehicle.rotors.thrust_coefficient * np.sum(held.speeds**2), 10.0)
    np.testing.assert_allclose(flight.manager.watch(600_000_000).speeds, vehicle.rotors.speed_min)


def test_controller_that_takes_over_in_free_flight_does_not_make_the_speeds_jump():
    flight, vehicle = Flight(flies=True), load_vehicle("qball_x4")
    flight.healthy = level_sample()._replace(q_xyzw=quaternion_from_euler(FAULT), body_rate=BIAS)
    found = [flight.next().speeds for _ in range(100)]
    flight.manager.configure(controllers.get("pid")(vehicle=vehicle), Patience())
    found += [flight.next().speeds for _ in range(100)]
    assert np.max(np.abs(np.diff(found[99:], axis=0))) < 0.01 * vehicle.hover_speed


def test_weak_rotor_keeps_the_controller_and_an_estimate_that_is_none_counts_as_healthy():
    manager = Flight(flies=True).manager
    assert manager.take_effectiveness(np.array([1.0, 0.5, 1.0, 1.0]))[1] == 0.5
    assert manager.must_keep() == "a rotor is weak"
    assert manager.take_effectiveness(np.full(4, np.nan)).tolist() == [1.0] * 4
    assert manager.take_effectiveness(None).tolist() == [1.0] * 4
    assert manager.must_keep() == ""
