"""The isolability matrix on the screen: marks, width, and the lines below it."""

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from quadftc_cli.checking import CHANGING, ITSELF, LASTING, NEVER, isolability_table
from quadftc_model.vehicle import load_vehicle
from quadftc_theory.isolability import IsolabilityResult, analyse, isolability_lines
from quadftc_theory.vehicle_equations import Assumptions

SMALL = IsolabilityResult(
    name="made up",
    assumptions={},
    faults=("a", "b", "c"),
    detectable=np.array([True, True, False]),
    isolable=np.array([[False, False, True], [False, False, True], [False, False, False]]),
    strongly_detectable=np.array([True, False, False]),
    strongly_isolable=np.array([[False, False, True], [False, False, False], [False, False, False]]),
)


def test_table_marks_each_pair_by_the_strongest_answer():
    columns = [list(column.cells) for column in isolability_table(SMALL).columns]
    assert [list(row) for row in zip(*columns[2:], strict=True)] == [
        [LASTING, ITSELF, NEVER, LASTING],
        [CHANGING, NEVER, ITSELF, CHANGING],
        [NEVER, NEVER, NEVER, ITSELF],
    ]


def test_lines_name_what_cannot_be_seen_and_what_cannot_be_told_apart():
    assert isolability_lines(SMALL) == [
        "made up",
        "cannot be detected: c",
        "detected only while they change: b",
        "cannot be told apart: a / b",
    ]


def test_lines_say_so_where_every_fault_can_be_told_apart():
    assumptions = Assumptions(sensor_set=("attitude", "gyro"), disturbances="absent")
    lines = isolability_lines(analyse(load_vehicle("qball_x4"), assumptions))
    assert lines[-1] == "every fault can be told apart from every other"


@pytest.mark.parametrize("actuators", ["axes", "rotors"])
def test_table_of_a_whole_imu_fits_a_screen_of_80_characters(actuators):
    assumptions = Assumptions(sensor_set=("attitude", "gyro", "accelerometer"), actuators=actuators)
    table = isolability_table(analyse(load_vehicle("qball_x4"), assumptions))
    screen = Console(width=80)
    with screen.capture() as capture:
        screen.print(table)
    lines = capture.get().splitlines()
    assert max(map(len, lines)) <= 80
    assert sum("disturbance" in line for line in lines) == 3
    assert not any("…" in line for line in lines)


def test_table_of_the_documentation_is_what_is_printed():
    assumptions = Assumptions(sensor_set=("attitude", "gyro"), disturbances="unknown_inputs")
    result = analyse(load_vehicle("qball_x4"), assumptions)
    heading, *rest = isolability_lines(result)
    screen = Console(width=200)
    with screen.capture() as capture:
        screen.print(isolability_table(result))
    table = [line.rstrip() for line in capture.get().splitlines() if line.strip()]
    documentation = Path(__file__).parents[1] / "docs" / "isolability.md"
    assert "\n".join([heading, *table, *rest]) in documentation.read_text(encoding="utf-8")
