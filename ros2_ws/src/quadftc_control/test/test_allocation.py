"""Allocation against linear programmes, its limits, and its ways through arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from layouts import SIXTH, circle, with_rotors
from scipy.optimize import linprog

from quadftc_control.allocation import allocate
from quadftc_model.vehicle import load_vehicle, vehicle_names

QBALL = load_vehicle("qball_x4")
VEHICLES = {name: load_vehicle(name) for name in vehicle_names()} | {
    "hexarotor": with_rotors(QBALL, circle(SIXTH), "PNPNPN"),
    "wide tail": with_rotors(QBALL, [[0.2, 0.15], [0.2, -0.15], [-0.25, 0.3], [-0.25, -0.3]], "PNNP"),
}
EVERY_VEHICLE = pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)
SHARE = st.floats(-1.5, 1.5)


def limits(vehicle):
    rotors = vehicle.rotors
    return rotors.thrust_coefficient * np.array([rotors.speed_min, rotors.speed_max]) ** 2


def wanted(vehicle, shares):
    """Thrust and torque in shares of what the vehicle can give; 1.5 is out of reach."""
    low, high = limits(vehicle)
    count = len(vehicle.rotors.positions)
    return np.array([count * (low + high) / 2, *(2.0 * vehicle.authority)]) * np.asarray(shares)


def forces(vehicle, allocated):
    return vehicle.rotors.thrust_coefficient * allocated.speeds**2


def best(vehicle, wrench):
    """Thrust and torque by three linear programmes, in the order of their importance."""
    low, high = limits(vehicle)
    # unknown: scale of tilt, thrust in rotors at full thrust, share of yaw, distance to the wanted thrust
    parts = ([0.0, *wrench[1:3], 0.0], [high, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, wrench[3]], [0.0] * 4)
    columns = np.stack([vehicle.force_allocation @ np.array(each) / high for each in parts], axis=1)
    a_ub = np.concatenate([columns, -columns, [[0, 1, 0, -1], [0, -1, 0, -1]]])
    count, thrust = len(columns), wrench[0] / high
    b_ub = np.array([1.0] * count + [-low / high] * count + [thrust, -thrust])

    def solved(cost, bounds):
        result = linprog(cost, a_ub, b_ub + 1e-9, bounds=bounds)
        assert result.success
        return result.x

    free = (None, None)
    scale = solved([-1, 0, 0, 0], [(0, 1), free, (0, 0), free])[0]  # yaw must not buy tilt
    found = solved([0, 0, 0, 1], [(scale, scale), free, (0, 1), free])[1]
    kept = solved([0, 0, -1, 0], [(scale, scale), (found, found), (0, 1), free])[2]
    return np.array([high * found, scale * wrench[1], scale * wrench[2], kept * wrench[3]])


@EVERY_VEHICLE
def test_what_four_rotors_can_give_is_given_exactly(vehicle):
    rng = np.random.default_rng(1)
    low, high = limits(vehicle)
    row_space = np.linalg.pinv(vehicle.effectiveness) @ vehicle.effectiveness
    for _ in range(200):
        thrusts = row_space @ rng.uniform(low, high, len(vehicle.rotors.positions))
        if not np.all((thrusts >= low) & (thrusts <= high)):  # only of a hexarotor: by forces that cancel
            continue
        wrench = vehicle.effectiveness @ thrusts
        allocated = allocate(vehicle, float(wrench[0]), wrench[1:])
        np.testing.assert_allclose([allocated.thrust, *allocated.torque], wrench, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(forces(vehicle, allocated), thrusts, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", vehicle_names())
def test_four_rotors_have_their_yaw_torque_of_hover_and_no_more(name):
    vehicle = load_vehicle(name)
    for share in (0.999, 1.001):
        torque = np.array([0.0, 0.0, share * vehicle.hover_yaw])
        given = [allocate(vehicle, vehicle.weight, sign * torque).torque[2] for sign in (1.0, -1.0)]
        kept = np.isclose(np.abs(given), torque[2], rtol=1e-9)
        assert np.all(kept) == (share < 1.0)


@EVERY_VEHICLE
@given(shares=st.tuples(st.floats(-0.5, 3.0), SHARE, SHARE, SHARE))
def test_rotors_stay_within_their_limits_and_give_what_is_told(vehicle, shares):
    wrench = wanted(vehicle, shares)
    allocated = allocate(vehicle, float(wrench[0]), wrench[1:])
    thrusts = forces(vehicle, allocated)
    low, high = limits(vehicle)
    assert np.all(thrusts >= low * (1 - 1e-9) - 1e-12)
    assert np.all(thrusts <= high * (1 + 1e-9))
    told = np.array([allocated.thrust, *allocated.torque])
    size = vehicle.effectiveness @ np.full(len(thrusts), high), 4.0 * vehicle.authority
    np.testing.assert_allclose(
        vehicle.effectiveness @ thrusts / [size[0][0], *size[1]], told / [size[0][0], *size[1]], atol=1e-9
    )
    # nothing is reversed, nothing exceeds what was wanted
    assert np.all(told[1:] * wrench[1:] >= 0.0)
    assert np.all(np.abs(told[1:]) <= np.abs(wrench[1:]))


@EVERY_VEHICLE
def test_tilt_comes_before_thrust_and_thrust_before_yaw_as_linear_programmes_say(vehicle):
    rng = np.random.default_rng(2)
    size = np.abs(wanted(vehicle, np.ones(4)))
    for shares in rng.uniform([-0.3, -1.0, -1.0, -1.0], [2.5, 1.0, 1.0, 1.0], (60, 4)):
        wrench = wanted(vehicle, shares)
        allocated = allocate(vehicle, float(wrench[0]), wrench[1:])
        told = np.array([allocated.thrust, *allocated.torque])
        np.testing.assert_allclose(told / size, best(vehicle, wrench) / size, atol=1e-6)


@EVERY_VEHICLE
def test_small_changes_of_what_is_wanted_change_little(vehicle):
    rng = np.random.default_rng(3)
    size = np.abs(wanted(vehicle, np.ones(4)))
    for _ in range(50):
        ends = (
            wanted(vehicle, rng.uniform([0.0, -1, -1, -1], [2.0, 1, 1, 1])),
            wanted(vehicle, rng.uniform([0.0, -1, -1, -1], [2.0, 1, 1, 1])),
        )
        path = np.linspace(*ends, 2001)
        allocated = allocate(vehicle, path[:, 0], path[:, 1:])
        told = np.concatenate([allocated.thrust[:, None], allocated.torque], axis=1)
        assert np.max(np.abs(np.diff(told / size, axis=0))) < 0.02


@pytest.mark.parametrize(
    "vehicle", [each for each in VEHICLES.values() if np.ptp(each.force_allocation[:, 0]) <= 1e-12]
)
def test_rotors_alike_give_no_torque(vehicle):
    low, high = limits(vehicle)
    middle = 0.5 * (low + high)
    allocated = allocate(vehicle, middle * len(vehicle.rotors.positions), np.zeros(3))
    np.testing.assert_allclose(forces(vehicle, allocated), middle, rtol=1e-12)
