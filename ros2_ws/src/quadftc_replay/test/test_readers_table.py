"""Tables with a mapping: every quantity, unit and frame; what is between the columns; cells that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadftc_bags.bag import BagError
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_replay import thinning
from quadftc_replay.readers import LogChoice, read_log
from quadftc_replay.readers.table import QUANTITIES, load_mapping

COUNT = 300
TIME = '[time]\ncolumn = "t"\n'


def signal(quantity: str, columns: str, unit: str, **more) -> str:
    names = ", ".join(f'"{name}"' for name in columns.split())
    lines = [f'quantity = "{quantity}"', f"columns = [{names}]", f'unit = "{unit}"']
    lines += [f"{key} = {value!r}".replace("'", '"') for key, value in more.items()]
    return "\n".join(["[[signal]]", *lines, ""])


def read(tmp_path, rows: list[list[object]], mapping: str, delimiter: str = ",", head: str = ""):
    table, file = tmp_path / "flight.csv", tmp_path / "mapping.toml"
    table.write_text(head + "".join(f"{delimiter.join(map(str, row))}\n" for row in rows))
    file.write_text(mapping)
    return read_log(table, LogChoice(mapping=file))


def table_of(columns: str, values: list[object]) -> list[list[object]]:
    return [["t", *columns.split()], *([0.01 * k, *values] for k in range(COUNT))]


VECTORS = [  # quantity, unit, frame, what 1, 2, 3 become
    ("gyro", "rad/s", "flu", [1.0, 2.0, 3.0]),
    ("gyro", "mrad/s", "frd", [0.001, -0.002, -0.003]),
    ("gyro", "deg/s", "", np.radians([1.0, 2.0, 3.0])),
    ("accelerometer", "g", "frd", [9.80665, -19.6133, -29.41995]),
    ("body_rate", "rad/s", "frd", [1.0, -2.0, -3.0]),
    ("magnetometer", "1", "frd", [1.0, -2.0, -3.0]),
    ("position", "cm", "ned", [0.02, 0.01, -0.03]),
    ("velocity", "mm/s", "enu", [0.001, 0.002, 0.003]),
    ("gps_velocity", "m/s", "ned", [2.0, 1.0, -3.0]),
    ("acceleration", "m/s^2", "ned", [2.0, 1.0, -3.0]),
    ("torque_command", "N m", "frd", [1.0, -2.0, -3.0]),
]


@pytest.mark.parametrize(("quantity", "unit", "frame", "expected"), VECTORS)
def test_vector_comes_into_si_and_the_axes_of_ros(tmp_path, quantity, unit, frame, expected):
    more = {"frame": frame} if frame else {}
    log = read(tmp_path, table_of("x y z", [1, 2, 3]), TIME + signal(quantity, "x y z", unit, **more))
    found = getattr(log, QUANTITIES[quantity].field)
    found = found[""] if isinstance(found, dict) else found
    np.testing.assert_allclose(found.value[0], expected)
    np.testing.assert_allclose(found.time, 0.01 * np.arange(COUNT))


def test_rotors_and_battery_come_into_shares_and_si(tmp_path):
    mapping = (
        TIME
        + signal("rotor_commands", "a b c d", "us", low=1000, high=2000)
        + signal("rotor_speeds", "a b c d", "rpm")
        + signal("battery", "e", "mV")
        + signal("thrust_command", "e", "1")
    )
    log = read(tmp_path, table_of("a b c d e", [1000, 1250, 1500, 2100, 12600]), mapping)
    assert log.rotor_commands is not None
    np.testing.assert_allclose(log.rotor_commands.value[0], [0.0, 0.25, 0.5, 1.0])
    assert log.rotor_speeds is not None
    np.testing.assert_allclose(log.rotor_speeds.value[0, 0], 1000.0 * np.pi / 30.0)
    assert log.battery is not None
    assert log.battery.value[0, 0] == pytest.approx(12.6)


def test_attitude_is_the_same_by_angles_or_quaternion_in_either_frame(tmp_path):
    angles = np.array([0.3, -0.2, 0.5])
    q = quaternion_from_euler(angles).tolist()
    ned = [angles[0], -angles[1], np.pi / 2.0 - angles[2]]
    q_ned = quaternion_from_euler(np.array(ned)).tolist()
    for columns, values, unit, frame in (
        ("r p y", angles.tolist(), "rad", "enu"),
        ("r p y", np.degrees(ned).tolist(), "deg", "ned"),
        ("x y z w", q, "1", "enu"),
        ("x y z w", q_ned, "1", "ned"),
    ):
        log = read(tmp_path, table_of(columns, values), TIME + signal("attitude", columns, unit, frame=frame))
        assert log.attitude is not None
        np.testing.assert_allclose(euler_from_quaternion(log.attitude.value[0]), angles, atol=1e-9)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_names_are_found_behind_other_lines_whatever_is_between_them(tmp_path, delimiter):
    log = read(
        tmp_path,
        table_of("x y z", [1, 2, 3]),
        TIME + signal("gyro", "x y z", "rad/s"),
        delimiter,
        '\ufeff"Product","a recorder"\nrate;100\n\n',
    )
    assert log.gyros[""].value.shape == (COUNT, 3)


def test_signals_of_different_rates_and_cells_that_are_no_numbers(tmp_path):
    rows: list[list[object]] = [["t", "x", "y", "z", "v"]]
    rows += [
        [0.01 * k, 1, "" if k == 7 else 2, "?" if k == 9 else 3, "" if k % 10 else 12.0] for k in range(COUNT)
    ]
    rows += [["", 1, 2, 3, ""], [3.5]]
    log = read(tmp_path, rows, TIME + signal("gyro", "x y z", "rad/s") + signal("battery", "v", "V"))
    assert len(log.gyros[""]) == COUNT
    assert np.argwhere(np.isnan(log.gyros[""].value)).tolist() == [[7, 1], [9, 2]]
    assert log.battery is not None
    assert len(log.battery) == COUNT // 10
    assert log.notes == ("1 cells are no numbers; left out", "1 of 302 rows have no time; left out")


def test_second_gyro_has_a_name_and_time_a_unit(tmp_path):
    mapping = '[time]\ncolumn = "t"\nunit = "ms"\n' + signal("gyro", "x y z", "rad/s")
    log = read(tmp_path, table_of("x y z", [1, 2, 3]), mapping + signal("gyro", "z y x", "rad/s", name="2"))
    np.testing.assert_array_equal(log.gyros["2"].value[0], [3.0, 2.0, 1.0])
    assert log.gyros[""].rate == pytest.approx(100_000.0)


def test_example_of_the_documents_is_one(tmp_path):
    document = next(each / "docs/diagnose.md" for each in Path(__file__).parents if (each / "docs").is_dir())
    path = tmp_path / "mapping.toml"
    path.write_text(document.read_text().split("```toml\n")[1].split("```")[0])
    mapping = load_mapping(path)
    assert [each.quantity for each in mapping.signal] == ["gyro", "rotor_commands"]


def test_long_table_is_thinned(tmp_path, monkeypatch):
    monkeypatch.setattr(thinning, "MOST", 100)
    monkeypatch.setattr("quadftc_replay.readers.table.BLOCK", 50)
    log = read(tmp_path, table_of("x y z", [1, 2, 3]), TIME + signal("gyro", "x y z", "rad/s"))
    assert log.notes == ("rows: long; of 300 samples one in 4 was read",)
    np.testing.assert_allclose(np.diff(log.gyros[""].time), 0.04)


GOOD = TIME + signal("gyro", "x y z", "rad/s")


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ("", "time: field required"),
        (TIME, "signal: field required"),
        (TIME + "[[signal]]\n", "signal.1.quantity: field required"),
        (GOOD + "colour = 1\n", "signal.1.colour: extra inputs are not permitted"),
        (GOOD.replace('"t"', '"t"\nunit = "h"'), "time.unit: input should be 's', 'ms', 'us' or 'ns'"),
        (GOOD + GOOD[len(TIME) :], "signal 2: gyro again; expected each once"),
        (TIME + signal("gyre", "x", "1"), "signal 1: quantity 'gyre'; expected one of gyro, accelerometer"),
        (TIME + signal("gyro", "x y", "rad/s"), "signal 1: 2 columns of gyro; expected 3"),
        (TIME + signal("rotor_speeds", "x", "rpm"), "signal 1: 1 columns of rotor_speeds; expected 2 to 16"),
        (TIME + signal("attitude", "x y z", "1"), "signal 1: unit '1' of attitude; expected rad, deg"),
        (TIME + signal("battery", "x", "V", frame="flu"), "frame 'flu' of battery; expected none"),
        (TIME + signal("battery", "x", "V", name="2"), "name '2' of battery; only a sensor has one"),
        (TIME + signal("rotor_commands", "a b", "us"), "unit 'us' without low and high"),
        (TIME + signal("battery", "x", "V", low=1.0, high=2.0), "only rotor_commands have them"),
        (
            TIME + signal("rotor_commands", "a b", "1", low=2.0, high=1.0),
            "low 2.0, high 1.0; expected low < h",
        ),
        ("[time", "not a mapping in TOML: "),
    ],
)
def test_mapping_that_makes_no_sense_says_where(tmp_path, mapping, words):
    path = tmp_path / "mapping.toml"
    path.write_text(mapping)
    with pytest.raises(BagError) as caught:
        load_mapping(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
