"""What is told of a vehicle: numbers, plan, warnings; and the document of the keys."""

from pathlib import Path

import pytest

import quadftc_model
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_model.vehicle_page import hover_command, page_rows, plan, warnings
from quadftc_model.vehicle_table import KEYS

SOURCE = Path(quadftc_model.__file__).parent / "vehicles" / "x500.toml"
DOCUMENT = Path(__file__).resolve().parents[4] / "docs" / "vehicle_files.md"


def with_changes(tmp_path, *pairs):
    text = SOURCE.read_text(encoding="utf-8")
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    return load_vehicle(str(tmp_path / "mine.toml"))


def test_page_has_what_follows_from_the_numbers():
    rows = {row.name: row for row in page_rows(load_vehicle("x500"))}
    assert rows["thrust to weight"].value == "1.69"
    assert rows["hover speed"].value == "769 rad/s"
    assert rows["authority roll"].value == "2.43 N m"
    assert rows["free rotation dies with"].value == "roll 1.3 s, pitch 1.3 s, yaw 2.8 s"


@pytest.mark.parametrize("name", vehicle_names())
def test_rotors_at_the_hover_command_carry_the_weight(name):
    vehicle = load_vehicle(name)
    rotors = vehicle.rotors
    thrust = len(rotors.positions) * rotors.thrust_gain * (hover_command(vehicle) - rotors.command_idle)
    assert thrust == pytest.approx(vehicle.weight)


def test_plan_has_each_rotor_at_its_place():
    lines = plan(load_vehicle("x500"))
    assert lines[0].split() == ["3↻", "1↺"]  # in front: left, right
    assert lines[-1].split() == ["2↺", "4↻"]


def test_usual_vehicle_gives_no_warning():
    assert [*warnings(load_vehicle("x500"))] == []


def test_poor_vehicle_is_warned_of(tmp_path):
    vehicle = with_changes(
        tmp_path,
        ("time_constant = 0.019", "time_constant = 0.08"),
        ("mass = 2.0643", "mass = 2.6"),
        ("rotor_drag = 8.06428e-5", "rotor_drag = 0.0"),
        ("drag_area = [0.03, 0.03, 0.05]", "drag_area = [0.0, 0.0, 0.0]"),
    )
    words = "\n".join(warnings(vehicle))
    for expected in (
        "thrust to weight 1.34",
        "hover command, 0.7457",
        "rotor lag 0.08 s",
        "no [aerodynamics]",
    ):
        assert expected in words


def test_vehicle_without_drag_is_told_without_division_by_zero(tmp_path):
    vehicle = with_changes(
        tmp_path, ("rotational_drag = [0.019, 0.019, 0.016]", "rotational_drag = [0, 0, 0]")
    )
    rows = {row.name: row.value for row in page_rows(vehicle)}
    assert rows["free rotation dies with"] == "roll never, pitch never, yaw never"


def test_document_has_every_key_with_its_unit_and_meaning():
    if not DOCUMENT.is_file():
        pytest.skip("not in a clone")
    text = DOCUMENT.read_text(encoding="utf-8")
    for keys in KEYS.values():
        for name, key in keys.items():
            row = next(
                line for line in text.splitlines() if line.startswith(f"| `{name}` | ") and key.doc in line
            )
            assert f"| {key.unit or '-'} |" in row
