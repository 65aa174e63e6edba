"""Quantities with units."""

import math

import pytest

from quadftc_model.units import quantity


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (2, "rad", 2.0),
        ("2", "rad", 2.0),
        ("180 deg", "rad", math.pi),
        ("180deg", "rad", math.pi),
        ("-3.5e-1 rad", "rad", -0.35),
        ("90 deg/s", "rad/s", math.pi / 2),
        ("180 deg/s²", "rad/s^2", math.pi),
        ("20 ms", "s", 0.02),
        ("inf", "s", math.inf),
        ("0.05 N m", "N m", 0.05),
        ("50 mNm", "N m", 0.05),
        ("25 %", "1", 0.25),
        ("1 g", "m/s^2", 9.80665),
        ("60 deg/sqrt(h)", "rad/sqrt(s)", math.pi / 180.0),  # 1 h is 3600 s
        ("180 deg/s/sqrt(Hz)", "rad/sqrt(s)", math.pi),
        ("3 rad s", "rad s", 3.0),  # not in the table: its own name only
    ],
)
def test_quantity_is_converted_to_si(value, unit, expected):
    assert quantity(value, unit) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "unit", "message"),
    [
        ("1 deg", "s", r"'1 deg': 'deg' is not a unit of this quantity; expected s, ms, min"),
        ("1 deg s", "rad s", r"'degs' is not a unit"),
        ("1 furlong", "1", r"'furlong' is not a unit of this quantity; expected %"),
        ("one", "rad", r"'one': expected a number in rad"),
        ("", "rad", r"'': expected a number in rad"),
        ("nan", "rad", r"'nan': expected a number in rad"),
        (math.nan, "rad", r"nan: expected a number in rad, not NaN"),
        (True, "rad", r"True: expected a number in rad"),
        (None, "rad", r"None: expected a number in rad"),
        ([1.0], "rad", r"\[1.0\]: expected a number in rad"),
    ],
)
def test_wrong_quantity_is_refused_with_its_value_and_unit(value, unit, message):
    with pytest.raises(ValueError, match=message):
        quantity(value, unit)
