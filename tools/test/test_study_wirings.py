"""The study of take-offs with motors, propellers or autopilot wired wrong."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from quadftc_model.vehicle import load_vehicle
from quadftc_tools.study.wirings import (
    ALL,
    EXCHANGED,
    LOST,
    SOUND,
    TURNED,
    judge_take_off,
    said_of,
    wire,
    wirings_table,
)

VEHICLE = load_vehicle("x500")


@pytest.mark.parametrize(
    ("wiring", "signs"),
    [
        ("roll reversed", [-1, 1, 1]),
        ("pitch reversed", [1, -1, 1]),
        ("yaw reversed", [1, 1, -1]),
        ("autopilot turned by 180 deg", [-1, -1, 1]),
        (SOUND, [1, 1, 1]),
        (LOST, [1, 1, 1]),
    ],
)
def test_wiring_reverses_what_its_name_says_and_nothing_else(wiring: str, signs: list[int]):
    wired = wire(VEHICLE, wiring, np.random.default_rng(0))
    answer = wired.effectiveness[1:] @ np.linalg.pinv(VEHICLE.effectiveness[1:])
    np.testing.assert_allclose(answer, np.diag(signs), atol=1e-9)


def test_autopilot_that_is_turned_exchanges_roll_and_pitch():
    wired = wire(VEHICLE, TURNED, np.random.default_rng(0))
    answer = wired.effectiveness[1:] @ np.linalg.pinv(VEHICLE.effectiveness[1:])
    np.testing.assert_allclose(np.abs(answer), [[0, 1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-9)


def test_two_motors_are_exchanged():
    wired = wire(VEHICLE, EXCHANGED, np.random.default_rng(0)).rotors
    moved = np.any(wired.positions != VEHICLE.rotors.positions, axis=1)
    assert moved.sum() == 2
    np.testing.assert_array_equal(wired.positions[moved][::-1], VEHICLE.rotors.positions[moved])


def test_yaw_that_is_reversed_is_said_of_both_logs():
    told = Counter(("yaw reversed", said_of(*judged)) for judged in judge_take_off(1, "yaw reversed"))
    assert told == {("yaw reversed", "response"): 2}
    assert "| yaw reversed | 2 | 2 | 100 [16, 100] | - | 0 | 0 |" in wirings_table(told)
    assert len(wirings_table(told).splitlines()) < len(ALL)  # what was not flown has no row
