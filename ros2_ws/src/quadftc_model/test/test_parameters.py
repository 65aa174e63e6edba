"""Parameters as fields of a dataclass, and components built from raw values."""

import dataclasses
import math

import pytest

from quadftc_model.parameters import Checked, build, parameter, parameters_of


@dataclasses.dataclass(frozen=True, kw_only=True)
class Component(Checked):
    """One parameter of every type."""

    context: str = "none"
    angle: float = parameter(0.5, unit="rad", low=-1.0, high=1.0, doc="a number")
    gains: tuple[float, ...] = parameter((1.0, 2.0, 3.0), unit="1/s", low=0.0, doc="a vector")
    count: int = parameter(2, low=1, high=10, doc="a whole number")
    flag: bool = parameter(False, doc="a truth")
    shape: str = parameter("round", choices=("round", "square"), doc="a choice")
    end: float = parameter(math.inf, unit="s", low=0.0, doc="a time without end")
    size: float = parameter(1.0, unit="{channel}", low=0.0, doc="a number in the unit of its channel")


def test_parameters_are_the_fields_with_metadata_in_their_order():
    names = [spec.name for spec in parameters_of(Component)]
    assert names == ["angle", "gains", "count", "flag", "shape", "end", "size"]


def test_build_without_values_gives_the_defaults():
    assert build(Component, {}, context="here") == Component(context="here")


@pytest.mark.parametrize(
    ("name", "raw", "expected"),
    [
        ("angle", "30 deg", math.pi / 6),
        ("angle", 1, 1.0),
        ("gains", 4, (4.0, 4.0, 4.0)),
        ("gains", "4 Hz", (4.0, 4.0, 4.0)),
        ("gains", [1, "2", "3 Hz"], (1.0, 2.0, 3.0)),
        ("count", "3", 3),
        ("count", 4.0, 4),
        ("flag", True, True),
        ("flag", "True", True),
        ("shape", "square", "square"),
        ("end", "inf", math.inf),
    ],
)
def test_build_converts_raw_values(name, raw, expected):
    value = getattr(build(Component, {name: raw}), name)
    assert value == pytest.approx(expected)
    assert type(value) is type(expected)


def test_unit_in_braces_is_that_of_the_context():
    assert build(Component, {"size": "180 deg"}, units={"channel": "rad"}).size == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"angel": 1}, r"angel: unknown parameter \(did you mean 'angle'\?\); known: angle, gains"),
        ({"zzz": 1}, r"zzz: unknown parameter; known: angle"),
        ({"context": "x"}, r"context: unknown parameter"),
        ({"angle": "fast"}, r"angle: 'fast': expected a number in rad"),
        ({"angle": "1 kg"}, r"angle: '1 kg': 'kg' is not a unit of this quantity; expected rad, deg, mrad"),
        ({"angle": [1.0]}, r"angle: \[1.0\]: expected one number in rad"),
        ({"angle": None}, r"angle: None: expected a number in rad"),
        ({"angle": 1.5}, r"angle = 1.5 rad: must be within \[-1, 1\]"),
        ({"gains": [1.0, 2.0]}, r"gains: \[1.0, 2.0\]: expected one number or 3, in 1/s"),
        ({"gains": [1.0, -2.0, 3.0]}, r"gains = -2.0 1/s: must be within \[0, inf\]"),
        ({"gains": [1.0, [2.0], 3.0]}, r"gains: \[2.0\]: expected a number in 1/s"),
        ({"gains": "inf"}, r"gains = inf 1/s: must be finite"),
        ({"count": 2.5}, r"count: 2.5: expected a whole number"),
        ({"count": "inf"}, r"count: 'inf': expected a whole number"),
        ({"count": 11}, r"count = 11: must be within \[1, 10\]"),
        ({"flag": 1}, r"flag: 1: expected true or false"),
        ({"shape": "oval"}, r"shape = 'oval': expected one of round, square"),
        ({"shape": 3}, r"shape: 3: expected a text"),
        ({"end": -1}, r"end = -1.0 s: must be within \[0, inf\]"),
    ],
)
def test_wrong_value_is_refused_with_its_parameter(values, message):
    with pytest.raises(ValueError, match=message):
        build(Component, values)


def test_bounds_are_reported_in_the_unit_of_the_context():
    with pytest.raises(ValueError, match=r"size = -1.0 rad: must be within"):
        build(Component, {"size": -1}, units={"channel": "rad"})


def test_not_a_number_is_refused_by_the_constructor():
    with pytest.raises(ValueError, match=r"angle = nan rad"):
        Component(angle=math.nan)
