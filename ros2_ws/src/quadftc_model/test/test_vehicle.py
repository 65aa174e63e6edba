"""Vehicles as data: what comes with quadftc is sound, and wrong files are refused by key."""

import re
from pathlib import Path

import numpy as np
import pytest

import quadftc_model
from quadftc_model.rotors import propeller_speeds
from quadftc_model.vehicle import load_vehicle, vehicle_names

TEXT = (Path(quadftc_model.__file__).parent / "vehicles" / "qball_x4.toml").read_text()
EVERY_VEHICLE = pytest.mark.parametrize("name", vehicle_names())


def changed(tmp_path, pattern, replacement):
    """Path of the Qball's file with one thing changed."""
    text, count = re.subn(pattern, replacement, TEXT, count=1, flags=re.MULTILINE)
    assert count == 1
    path = tmp_path / "changed.toml"
    path.write_text(text)
    return str(path)


@EVERY_VEHICLE
def test_vehicle_carries_its_own_name(name):
    assert load_vehicle(name).name == name


@EVERY_VEHICLE
def test_principal_moments_are_those_of_a_body(name):
    inertia = load_vehicle(name).inertia
    assert np.all(2.0 * inertia <= np.sum(inertia))  # triangle inequality


@EVERY_VEHICLE
def test_reaction_torques_oppose_the_spin(name):
    rotors = load_vehicle(name).rotors
    assert np.array_equal(rotors.yaw_sign, -rotors.spin_sign)


@EVERY_VEHICLE
def test_thrust_through_the_centre_at_trim(name):
    vehicle = load_vehicle(name)
    trim = np.full(len(vehicle.rotors.yaw_sign), vehicle.rotors.command_trim)
    np.testing.assert_allclose(vehicle.mixer @ trim, np.zeros(3), atol=1e-12 * np.max(vehicle.authority))


@EVERY_VEHICLE
def test_numbers_cannot_be_overwritten(name):
    with pytest.raises(ValueError, match="read-only"):
        load_vehicle(name).inertia[0] = 1.0


def test_path_of_a_file_is_a_vehicle_too(tmp_path):
    assert load_vehicle(changed(tmp_path, r"^mass = 1.4", "mass = 2.0")).mass == 2.0


def test_unknown_vehicle_is_refused_with_those_that_there_are():
    with pytest.raises(ValueError, match=r"no vehicle 'qball'; there are: .*qball_x4.*\.toml file"):
        load_vehicle("qball")


@pytest.mark.parametrize(
    ("pattern", "replacement", "message"),
    [
        (r"^mass = 1.4", "mass = -1.4", r"mass = -1.4: must be positive"),
        (r"^mass = 1.4", "mass = 1500", r"mass = 1500: 14710 N of weight on 24 N of thrust"),
        (r"^yaw_sign = .*", "yaw_sign = [1, 1, 1, 1]", r"rotors.yaw_sign = .*: expected the opposite of"),
        (r"^mass = 1.4", "mass = true", r"mass = True: expected a finite number"),
        (r"^mass = 1.4", "mass = nan", r"mass = nan: expected a finite number"),
        (r"^mass = .*", "", r"mass: missing; expected a finite number, in kg"),
        (r"^mass = 1.4", "weight = 1\nmass = 1.4", r"weight: unknown key"),
        (r"^name = .*", "name = 3", r"name = 3: expected a text"),
        (r"^inertia = \[0.03", "inertia = [0", r"inertia = .*: must be positive"),
        (
            r"^inertia = \[0.03, ",
            "inertia = [",
            r"inertia = \[0.03, 0.04\]: expected finite numbers \[x, y, z\], in kg m\^2",
        ),
        (r"^rotational_drag = \[0", "rotational_drag = [-0", r"rotational_drag = .*: must be not negative"),
        (r"^\[rotors\]", "[motors]", r"motors: unknown key \(did you mean 'rotors'\?\)"),
        (r"^yaw_sign = \[1, ", "yaw_sign = [", r"rotors.yaw_sign: expected 4 numbers"),
        (r"^positions = .*", "positions = [1, 2]", r"rotors.positions = \[1, 2\]: expected finite numbers"),
        (r"^positions = .*", "positions = [['a', 'b']]", r"rotors.positions = .*: expected finite numbers"),
        (
            r"^positions = .*",
            "positions = [[1, 1], [1, 1], [1, 1], [1, 1]]",
            r"rotors.positions = .*: this layout cannot give a torque about each axis: roll comes only",
        ),
        (r"^command_trim = .*", "command_trim = 0.2", r"rotors.command_trim = 0.2: must be in \(0.05, 0.1\)"),
        (r"^thrust_gain = .*", "thrust_gain = 0.0", r"rotors.thrust_gain = 0.0: must be positive"),
        (r"^time_constant = .*", "time_constant = -1.0", r"rotors.time_constant = -1.0: must be positive"),
        (
            r"^rotor_inertia = .*",
            "rotor_inertia = -1.0",
            r"rotors.rotor_inertia = -1.0: must be not negative",
        ),
        (r"^thrust_gain", "thrust_gian = 1.0\nthrust_gain", r"rotors.thrust_gian: unknown key"),
        (r"^rotor_drag = .*", "rotor_drag = -1.0", r"aerodynamics.rotor_drag = -1.0: must be not negative"),
        (r"^drag_area = .*", "drag_area = 1.0", r"aerodynamics.drag_area = 1.0: expected finite numbers"),
        (r"^drag_area = .*", "wings = 2", r"aerodynamics.wings: unknown key"),
        (
            r"(?s)^mass(.*)^\[aerodynamics\].*",
            r"aerodynamics = 1\nmass\1",
            r"aerodynamics = 1: expected a table",
        ),
        (r"^\[rotors\]", "[rotors", r"line \d+: '\[rotors': Expected ']' at the end of a table declaration"),
    ],
)
def test_wrong_file_is_refused_with_its_path_and_key(tmp_path, pattern, replacement, message):
    path = changed(tmp_path, pattern, replacement)
    with pytest.raises(ValueError, match=rf"vehicle {re.escape(path)}(:\d+)?: {message}"):
        load_vehicle(path)


def test_missing_file_is_refused_with_its_path(tmp_path):
    with pytest.raises(ValueError, match=r"absent\.toml"):
        load_vehicle(str(tmp_path / "absent.toml"))


def test_file_that_is_no_text_is_refused_with_its_path(tmp_path):
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"vehicle .*binary\.toml"):
        load_vehicle(str(tmp_path / "binary.toml"))


def test_a_value_with_a_unit_and_no_quotes_is_shown_with_its_line(tmp_path):
    (tmp_path / "bare.toml").write_text("# of a quad\nmass = 0.65 kg\n")
    said = r"bare\.toml: line 2: 'mass = 0.65 kg': .*: a value with a unit stands in quotes"
    with pytest.raises(ValueError, match=said):
        load_vehicle(str(tmp_path / "bare.toml"))


@pytest.mark.parametrize(
    ("text", "message"),
    [("#" + "x" * 50_000_000, "larger than 256 KiB"), ("a = " + "[" * 100_000, "nested too deeply")],
    ids=["large", "deep"],
)
def test_file_that_is_large_or_deep_is_refused_at_once(tmp_path, text, message):
    path = tmp_path / "hostile.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"vehicle {re.escape(str(path))}: {message}"):
        load_vehicle(str(path))


@EVERY_VEHICLE
def test_rotors_at_hover_speed_carry_the_weight_and_turn_nothing(name):
    vehicle = load_vehicle(name)
    rotors = vehicle.rotors
    thrusts = np.full(len(rotors.positions), rotors.thrust_coefficient * vehicle.hover_speed**2)
    expected = [vehicle.mass * 9.80665, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(vehicle.effectiveness @ thrusts, expected, rtol=1e-12, atol=1e-12)


@EVERY_VEHICLE
def test_speed_limits_are_those_of_the_commands(name):
    vehicle = load_vehicle(name)
    rotors = vehicle.rotors
    commands = np.array([rotors.command_min, rotors.command_max])
    np.testing.assert_allclose([rotors.speed_min, rotors.speed_max], propeller_speeds(vehicle, commands))
    assert rotors.speed_min < vehicle.hover_speed < rotors.speed_max
    most = len(rotors.positions) * rotors.thrust_gain * (rotors.command_max - rotors.command_idle)
    np.testing.assert_allclose(vehicle.thrust_max, most, rtol=1e-12)


@EVERY_VEHICLE
def test_effectiveness_is_the_mixer_over_thrust(name):
    vehicle = load_vehicle(name)
    arm = vehicle.rotors.torque_to_thrust * vehicle.rotors.yaw_sign
    assert np.array_equal(vehicle.effectiveness[0], np.ones(len(arm)))
    np.testing.assert_allclose(vehicle.effectiveness[1], vehicle.rotors.positions[:, 1], rtol=1e-12)
    np.testing.assert_allclose(vehicle.effectiveness[2], -vehicle.rotors.positions[:, 0], rtol=1e-12)
    np.testing.assert_allclose(vehicle.effectiveness[3], arm, rtol=1e-12)


def test_vehicle_without_aerodynamics_has_no_drag(tmp_path):
    air = load_vehicle(changed(tmp_path, r"(?s)^\[aerodynamics\].*", "")).aerodynamics
    assert air.rotor_drag == 0.0
    assert not np.any(air.drag_area)
    assert not np.any(air.imu_position)


def test_all_that_is_wrong_is_told_at_once_with_line_unit_and_hint(tmp_path):
    text = TEXT.replace("mass = 1.4 ", 'mass = "1.4 kg" ').replace("yaw_gain =", "yaw_gian =")
    text = text.replace("[aerodynamics]", "[aerodynamics]\ntime_constant = 0.1")
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match="wrong") as caught:
        load_vehicle(str(path))
    lines = text.splitlines()

    def number(start):
        return next(k for k, line in enumerate(lines, 1) if line.startswith(start))

    assert str(caught.value).splitlines() == [
        f"vehicle {path}:{number('mass')}: mass = '1.4 kg': expected the number alone, in kg, without quotes",
        f"vehicle {path}:{number('[rotors]')}: rotors.yaw_gain: missing; expected a finite number, in N m, "
        "not beyond 1e+09: reaction torque per unit of command",
        f"vehicle {path}:{number('yaw_gian')}: rotors.yaw_gian: unknown key (did you mean 'yaw_gain'?)",
        f"vehicle {path}:{number('[aerodynamics]') + 1}: aerodynamics.time_constant: unknown key here; it "
        "belongs into [rotors]",
    ]


def test_a_misspelt_key_hides_no_wrong_count_and_no_wrong_number(tmp_path):
    path = changed(
        tmp_path,
        r"(?s)^mass = 1.4(.*)^spin_sign = [^\n]*(.*)^time_constant = [^ ]*(.*)^rotor_drag",
        r'mass = "1400 g"\1spin_sign = [1, 1]\2time_constant = 15.0\3rotor_darg',
    )
    with pytest.raises(ValueError, match="mass") as refused:
        load_vehicle(path)
    found = [line.split(": ", 1) for line in str(refused.value).splitlines()]
    keys = ["mass", "rotors.spin_sign", "rotors.time_constant", "aerodynamics.rotor_darg"]
    assert [re.match(r"[\w.]+", text)[0] for _, text in found] == keys
    lines = [int(where.rpartition(":")[2]) for where, _ in found]
    assert lines == sorted(lines)


def test_numbers_that_are_wrong_together_are_told_together(tmp_path):
    path = changed(
        tmp_path, r"(?s)^mass = 1.4(.*)^time_constant = [^ ]*", r"mass = 1400\1time_constant = 15.0"
    )
    with pytest.raises(ValueError, match=r"1400 g are 1.4 kg\n.*rotors.time_constant = 15: expected within"):
        load_vehicle(path)
