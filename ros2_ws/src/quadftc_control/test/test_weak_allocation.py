"""Allocation to weak rotors against linear programmes over the thrusts of the rotors."""

import numpy as np
import pytest
from layouts import SIXTH, circle, with_rotors
from scipy.optimize import linprog, lsq_linear

from quadftc_control.allocation import Allocated, allocate
from quadftc_control.weak_allocation import CARRIED, GIVES_WAY
from quadftc_model.vehicle import load_vehicle
from quadftc_model.wrench_set import limits

X500, EIGHTH = load_vehicle("x500"), np.arange(8) * 45.0 + 22.5
VEHICLES = {
    "quadrotor x": X500,
    "quadrotor +": load_vehicle("qball_x4"),
    "hexarotor PNPNPN": with_rotors(X500, circle(SIXTH), "PNPNPN"),
    "hexarotor PPNNPN": with_rotors(X500, circle(SIXTH), "PPNNPN"),
    "octorotor": with_rotors(X500, circle(EIGHTH), "PNPNPNPN"),
    "octorotor, coaxial": with_rotors(X500, circle(np.repeat([45.0, 135.0, 225.0, 315.0], 2)), "PNPNPNPN"),
}
EVERY_VEHICLE = pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)


def cases(vehicle, count, seed):
    """Wrenches within and out of reach, with weak rotors, of which one is off in every third case."""
    rng = np.random.default_rng(seed)
    rotors = len(vehicle.rotors.positions)
    size = np.array([vehicle.thrust_max, *(1.2 * vehicle.authority)])
    for index in range(count):
        effectiveness = np.where(rng.uniform(size=rotors) < 0.4, rng.uniform(0.1, 1.0, rotors), 1.0)
        effectiveness[rng.integers(rotors)] = 0.0 if index % 3 == 0 else 0.5
        yield size * rng.uniform([0.0, -1.0, -1.0, -1.0], [1.0, 1.0, 1.0, 1.0]), effectiveness


def best(vehicle, wrench, effectiveness):
    """Thrust and torque by least squares for the tilt, then by a linear programme for each of the others."""
    low, high = np.split(limits(vehicle, effectiveness), 2)
    effect, count = vehicle.effectiveness, len(effectiveness)
    arms = np.max(np.abs(effect[1:3]))
    room = np.maximum(high - low, 1e-9)
    shares = lsq_linear(
        effect[1:3] * room / arms, (wrench[1:3] - effect[1:3] @ low) / arms, (0.0, 1.0), method="bvls"
    )
    tilt = effect[1:3] @ (low + room * shares.x)

    def nearest(row, wanted, rows, values, slack):
        """The value of a row of the effect nearest to the wanted one, where others have values."""
        scale = np.max(np.abs(effect[rows]), axis=1, keepdims=True)
        equal = np.column_stack([effect[rows] / scale, np.zeros((len(rows), 1))])
        own = np.max(np.abs(effect[row]))
        apart = np.array([[*effect[row] / own, -1.0], [*(-effect[row] / own), -1.0]])
        upper = np.concatenate([equal, -equal, apart])
        found = np.asarray(values) / scale[:, 0]
        bound = np.concatenate([found + slack, slack - found, [wanted / own, -wanted / own]])
        bounds = [*zip(low, high, strict=True), (None, None)]
        result = linprog([0.0] * count + [1.0], upper, bound, bounds=bounds)
        return effect[row] @ result.x[:-1] if result.success else None

    thrust = nearest(0, wrench[0], [1, 2], tilt, 1e-7)
    carried = CARRIED * vehicle.weight
    if thrust > carried:
        highest = nearest(0, np.sum(high), [1, 2, 3], [*tilt, 0.0], 1e-7)
        if highest is None:
            return None  # the tilt needs a yaw torque: no programme says how much
        carried += GIVES_WAY * max(carried - highest, 0.0)
    if thrust > carried:
        upright = nearest(0, wrench[0], [1, 2, 3], [*tilt, 0.0], 1e-7)
        thrust = nearest(0, max(upright, min(thrust, carried)), [1, 2], tilt, 1e-6)
    return np.array([thrust, *tilt, nearest(3, wrench[3], [0, 1, 2], [thrust, *tilt], 1e-5)])


@EVERY_VEHICLE
def test_the_result_is_that_of_the_programmes(vehicle):
    size = np.array([vehicle.thrust_max, *vehicle.authority[:2], 2.0 * vehicle.authority[2]])
    compared = 0
    for wrench, effectiveness in cases(vehicle, 30, 1):
        allocated = allocate(vehicle, float(wrench[0]), wrench[1:], effectiveness)
        told = np.array([allocated.thrust, *allocated.torque])
        programmes = best(vehicle, wrench, effectiveness)
        if programmes is not None:
            compared += 1
            np.testing.assert_allclose(told / size, programmes / size, atol=1e-4)
    assert compared > 20


@EVERY_VEHICLE
def test_rotors_stay_within_their_limits_and_give_what_is_told(vehicle):
    rotors = vehicle.rotors
    size = np.array([vehicle.thrust_max, *vehicle.authority])
    for wrench, effectiveness in cases(vehicle, 100, 2):
        allocated = allocate(vehicle, float(wrench[0]), wrench[1:], effectiveness)
        assert np.all(allocated.speeds >= rotors.speed_min * (1 - 1e-9))
        assert np.all(allocated.speeds <= rotors.speed_max * (1 + 1e-9))
        thrusts = effectiveness * rotors.thrust_coefficient * allocated.speeds**2
        told = np.array([allocated.thrust, *allocated.torque])
        np.testing.assert_allclose(vehicle.effectiveness @ thrusts / size, told / size, atol=1e-7)


@EVERY_VEHICLE
def test_healthy_rotors_get_the_same_bit_for_bit(vehicle):
    count = len(vehicle.rotors.positions)
    for wrench, _ in cases(vehicle, 30, 3):
        arguments = vehicle, float(wrench[0]), wrench[1:]
        for healthy in (np.ones(count), np.full(count, 1.01)):
            for one, other in zip(allocate(*arguments), allocate(*arguments, healthy), strict=True):
                np.testing.assert_array_equal(one, other)


def test_weak_rotors_give_what_is_wanted_where_they_can():
    vehicle = VEHICLES["quadrotor x"]
    torque = np.array([0.1, -0.1, 0.01])
    allocated = allocate(vehicle, vehicle.weight, torque, np.array([0.85, 1.0, 1.0, 0.9]))
    np.testing.assert_array_equal(allocated.torque, torque)
    assert allocated.thrust == vehicle.weight


def test_one_rotor_of_four_off_keeps_tilt_and_gives_up_yaw():
    vehicle = VEHICLES["quadrotor x"]
    effectiveness = np.array([0.0, 1.0, 1.0, 1.0])
    torque = np.array([0.3, 0.3, 0.0])  # about the axis through the other two, where rotor 1 pushes one way
    allocated = allocate(vehicle, 10.0, torque, effectiveness)
    np.testing.assert_allclose(allocated.torque[:2], torque[:2], rtol=1e-9)
    assert allocated.thrust == pytest.approx(10.0)
    assert abs(allocated.torque[2]) > 0.05


@EVERY_VEHICLE
def test_small_changes_of_the_effectiveness_change_little(vehicle):
    rng = np.random.default_rng(4)
    count = len(vehicle.rotors.positions)
    size = np.array([vehicle.thrust_max, *vehicle.authority])
    for _ in range(5):
        path = np.linspace(np.ones(count), rng.uniform(0.0, 1.0, count), 2001)[1:]
        torque = np.broadcast_to(vehicle.authority * rng.uniform(-0.5, 0.5, 3), (len(path), 3))
        allocated = allocate(vehicle, np.full(len(path), vehicle.weight), torque, path)
        told = np.concatenate([allocated.thrust[:, None], allocated.torque], axis=1)
        assert np.max(np.abs(np.diff(told / size, axis=0))) < 0.03


@EVERY_VEHICLE
def test_batch_equals_the_loop(vehicle):
    wrenches, weak, single = many_cases(vehicle)
    compare(vehicle, allocate(vehicle, wrenches[:, 0], wrenches[:, 1:], weak), single)


def test_jax_equals_the_loop():
    jax = pytest.importorskip("jax")
    vehicle = VEHICLES["quadrotor x"]
    wrenches, weak, single = many_cases(vehicle)
    with jax.enable_x64(True):
        compiled = jax.jit(lambda t, q, e: allocate(vehicle, t, q, e))
        compare(vehicle, compiled(wrenches[:, 0], wrenches[:, 1:], weak), single)


def many_cases(vehicle):
    wrenches, weak = (np.array(each) for each in zip(*cases(vehicle, 30, 5), strict=True))
    weak[::4] = 1.0
    loop = [allocate(vehicle, float(w[0]), w[1:], e) for w, e in zip(wrenches, weak, strict=True)]
    single = Allocated(*(np.array(each) for each in zip(*loop, strict=True)))
    return wrenches, weak, single


def compare(vehicle, many, single):
    np.testing.assert_allclose(many.thrust, single.thrust, rtol=1e-9)
    np.testing.assert_allclose(many.torque, single.torque, rtol=1e-8, atol=1e-10)
    highest = vehicle.rotors.speed_max**2
    np.testing.assert_allclose(many.speeds**2, single.speeds**2, atol=1e-8 * highest)
