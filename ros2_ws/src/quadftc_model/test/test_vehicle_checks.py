"""Vehicles that cannot be are refused by the number that is wrong; unusual ones that can be are not."""

import dataclasses

import numpy as np
import pytest

from quadftc_model.vehicle import load_vehicle, vehicle_names

QBALL = load_vehicle("qball_x4")
SIGNS = np.array([1.0, 1.0, -1.0, -1.0])


def with_parts(vehicle=QBALL, *, rotors=None, aerodynamics=None, **body):
    """The vehicle with other numbers, checked anew."""
    return dataclasses.replace(
        vehicle,
        rotors=dataclasses.replace(vehicle.rotors, **(rotors or {})),
        aerodynamics=dataclasses.replace(vehicle.aerodynamics, **(aerodynamics or {})),
        **body,
    )


def signs(*yaw_sign):
    yaw_sign = np.array(yaw_sign, dtype=float)
    return {"yaw_sign": yaw_sign, "spin_sign": -yaw_sign}


IMPOSSIBLE = {
    "too heavy": (
        {"mass": 1500.0},
        r"^mass = 1500: 14710 N of weight on 24 N of thrust .* weight 0\.00163: exp",
    ),
    "just too heavy": (
        {"mass": 2.14},
        r"^mass = 2.14: .* thrust to weight 1.14: expected within \[1.15, 50\]",
    ),
    "places in mm": (
        {"rotors": {"positions": 1e3 * QBALL.rotors.positions}},
        r"^rotors.positions = .*: a rotor 2\d\d m from the centre: expected within 15 m; 2.* mm are 0.2",
    ),
    "too light": ({"mass": 0.014}, r"^mass = 0.014: .*: expected within"),
    "cannot sink": (
        {"rotors": {"command_idle": 0.0}},
        r"^rotors.command_min = 0.05: it carries 24 N of 13.73 N",
    ),
    "all turn alike": (
        {"rotors": signs(1, 1, 1, 1)},
        r"^rotors.yaw_sign = \[1.0, 1.0, 1.0, 1.0\]: this layout .*: yaw comes only together with thrust",
    ),
    "neighbours turn alike": (
        {
            "rotors": {
                "positions": 0.2 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]),
                **signs(1, -1, -1, 1),
            }
        },
        r"^rotors.positions = .*: roll comes only together with thrust, pitch or yaw",
    ),
    "spin with the reaction torque": (
        {"rotors": {"spin_sign": SIGNS}},
        r"^rotors.yaw_sign = \[1.0, 1.0, -1.0, -1.0\]: expected the opposite of rotors.spin_sign, \[-1.0",
    ),
    "half a sign": ({"rotors": {"spin_sign": -0.5 * SIGNS}}, r"^rotors.spin_sign = .*: expected 1 or -1"),
    "rotors in a line": (
        {"rotors": {"positions": np.array([[-0.2, 0], [0.2, 0], [0.1, 0], [-0.1, 0]])}},
        r"^rotors.positions = .*: roll comes only together",
    ),
    "no body": (
        {"inertia": np.array([0.01, 0.01, 0.04])},
        r"^inertia = .*: no body has these: 0.04 kg m² .*, 0.02",
    ),
    "a gram of inertia": (
        {"inertia": QBALL.inertia * 1e-3},
        r"^inertia = .*: expected each within \[0.00056, 0.126\]",
    ),
    "wide inertia": ({"inertia": QBALL.inertia * 10.0}, r"^inertia = .*: expected each within"),
    "heavy rotors": (
        {"rotors": {"rotor_inertia": 0.02}},
        r"^rotors.rotor_inertia = 0.02: .* exceed inertia\[2\]",
    ),
    "idle above the trim": (
        {"rotors": {"command_idle": 0.08}},
        r"^rotors.command_idle = 0.08: expected less than",
    ),
    "centre of mass outside": (
        {"rotors": {"positions": QBALL.rotors.positions + np.array([0.15, 0.0])}},
        r"^rotors.positions = .*: hover needs the thrusts \[.*\] N, expected within \[0, 6\] N",
    ),
    "no torque about yaw": (
        {"rotors": {"yaw_gain": 0.04}},
        r"^rotors.yaw_gain = 0.04: .* yaw torque, 0.0856 rad/s²",
    ),
    "a long propeller": (
        {"rotors": {"yaw_gain": 40.0}},
        r"^rotors.yaw_gain = 40: .* 0.333 m, expected less than the 0.2",
    ),
    "slow rotors": (
        {"rotors": {"time_constant": 1.0}},
        r"^rotors.time_constant = 1: expected within \[0.0005, 0.5\] s",
    ),
    "rotors without lag": (
        {"rotors": {"time_constant": 1e-5}},
        r"^rotors.time_constant = 1e-05: expected within",
    ),
    "honey": (
        {"rotational_drag": np.full(3, 5.0)},
        r"^rotational_drag = .*: a free rotation would die within 0.006 s",
    ),
    "drag of a rotor": (
        {"aerodynamics": {"rotor_drag": 8e-3}},
        r"^aerodynamics.rotor_drag = 0.008: .* within 0.0927 s",
    ),
    "sail": (
        {"aerodynamics": {"drag_area": np.full(3, 6.0)}},
        r"^aerodynamics.drag_area = .*: expected at most 0.64 m²",
    ),
    "IMU on a mast": (
        {"aerodynamics": {"imu_position": np.array([0.0, 0.0, 5.0])}},
        r"^aerodynamics.imu_position = \[0.0, 0.0, 5.0\]: expected at most 0.4 m",
    ),
}


@pytest.mark.parametrize(("changes", "message"), IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_impossible_vehicle_is_refused_by_its_number(changes, message):
    with pytest.raises(ValueError, match=message):
        with_parts(**changes)


@pytest.mark.parametrize("layout", ["hexarotor", "octorotor", "pairs on an axis", "three in front"])
def test_other_layouts_are_possible(layout):
    angle = {
        "hexarotor": np.arange(6) / 6.0,
        "octorotor": np.arange(8) / 8.0,
        "pairs on an axis": np.arange(8) // 2 / 4.0,
    }
    turn = 2.0 * np.pi * angle.get(layout, np.array([0.0, 0.2, 0.5, 0.8]))
    alternating = np.where(np.arange(len(turn)) % 2 == 0, 1.0, -1.0)
    positions = 0.2 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    if layout == "three in front":
        positions -= positions.mean(axis=0)
    vehicle = with_parts(rotors={"positions": positions, **signs(*alternating)})
    assert vehicle.thrust_max == pytest.approx(6.0 * len(turn))


@pytest.mark.parametrize("name", vehicle_names())
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_vehicles_of_other_size_fly_by_the_laws_of_scale(name, scale):
    """Mass with the cube, inertia with the fifth, thrust with the cube of the length: same Froude number."""
    vehicle = load_vehicle(name)
    rotors, cube = vehicle.rotors, scale**3
    with_parts(
        vehicle,
        mass=vehicle.mass * cube,
        inertia=vehicle.inertia * scale**5,
        rotational_drag=vehicle.rotational_drag * scale**4.5,
        rotors={
            "positions": rotors.positions * scale,
            "thrust_gain": rotors.thrust_gain * cube,
            "yaw_gain": rotors.yaw_gain * scale * cube,
            "thrust_coefficient": rotors.thrust_coefficient * scale**4,
            "rotor_inertia": rotors.rotor_inertia * scale**5,
        },
        aerodynamics={"rotor_drag": vehicle.aerodynamics.rotor_drag * cube, "drag_area": np.zeros(3)},
    )


def test_what_is_wrong_apart_from_each_other_is_told_at_once():
    with pytest.raises(ValueError, match="mass") as refused:
        with_parts(mass=1500.0, rotors={"yaw_sign": SIGNS * 0.0 + 1.0, "time_constant": 25.0})
    assert [line.split()[0] for line in str(refused.value).splitlines()] == [
        *("rotors.yaw_sign", "mass", "rotors.time_constant"),
    ]
