"""Node parameters become components and come back."""

import dataclasses
from array import array

import pytest

from quadftc_model.assembly import (
    build_named,
    build_prefixed,
    component_from,
    get,
    node_values,
    texts,
    vehicle_from,
)
from quadftc_model.parameters import Checked, parameter
from quadftc_model.registry import Registry


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Law(Checked):
    """A component with a parameter of each type."""

    gains: tuple[float, ...] = parameter((1.0, 2.0, 3.0), low=0.0, doc="gains")
    rate: float = parameter(1.0, unit="rad/s", doc="a rate")
    count: int = parameter(3, doc="a number")
    fast: bool = parameter(False, doc="a switch")
    model: str = parameter("plain", choices=("plain", "fancy"), doc="a choice")
    vehicle: object = None


@pytest.fixture
def laws() -> Registry:
    registry = Registry("law", "quadftc_model", "quadftc.none")
    registry.register("plain_law")(Law)
    return registry


def test_what_is_written_out_builds_the_same_component():
    law = Law(gains=(0.1, 0.2, 1 / 3), rate=2.5, count=7, fast=True, model="fancy")
    values = node_values(law, "law")
    assert values == {
        "law.gains": [0.1, 0.2, 1 / 3],
        "law.rate": 2.5,
        "law.count": 7,
        "law.fast": True,
        "law.model": "fancy",
    }
    again = build_prefixed(Law, {**values, "another": 1, "lawyer.rate": 3.0}, "law")
    assert dataclasses.astuple(again) == dataclasses.astuple(law)


def test_parameters_without_a_prefix_build_the_same_component():
    law = Law(gains=(0.1, 0.2, 1 / 3), count=7)
    values = node_values(law, "")
    assert values["gains"] == [0.1, 0.2, 1 / 3]
    again = build_named(Law, {**values, "gains": array("d", values["gains"]), "another": 1}, vehicle="mine")
    assert dataclasses.astuple(again)[:-1] == dataclasses.astuple(law)[:-1]
    assert again.vehicle == "mine"


def test_component_is_chosen_by_name_and_keeps_its_defaults(laws):
    parameters = {"observer": "plain_law", "plain_law.gains": array("d", [4, 5, 6]), "use_sim_time": True}
    law = component_from(laws, parameters, "observer", vehicle="mine")
    assert (law.gains, law.rate, law.vehicle) == ((4.0, 5.0, 6.0), 1.0, "mine")


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "observer: missing parameter"),
        ({"observer": 3}, "observer = 3: expected str"),
        ({"observer": "plain_lwa"}, r"no law 'plain_lwa' \(did you mean 'plain_law'\?\)"),
        (
            {"observer": "plain_law", "plain_law.rte": 1.0},
            r"plain_law\.rte: unknown parameter .did you mean 'rate'",
        ),
        ({"observer": "plain_law", "plain_law.gains": [-1.0, 0.0, 0.0]}, r"plain_law\.gains = -1.0"),
        (
            {"observer": "plain_law", "plain_law.gains": [1.0]},
            r"plain_law\.gains: \[1.0\]: expected one number or 3",
        ),
    ],
)
def test_a_wrong_parameter_is_named_in_full(laws, parameters, message):
    with pytest.raises(ValueError, match=message):
        component_from(laws, parameters, "observer")


def test_types_are_those_of_ros():
    assert get({"rate": 250}, "rate", float) == 250.0
    assert type(get({"rate": 250}, "rate", float)) is float
    for value, kind in ((True, int), (True, float), (1, bool), (1.0, int), ("1", int)):
        with pytest.raises(ValueError, match=r"x = .*: expected"):
            get({"x": value}, "x", kind)


def test_lists_of_texts_may_be_missing_or_untyped():
    assert texts({}, "faults") == []
    assert texts({"faults": array("B")}, "faults") == []  # how ROS gives a list without a type
    assert texts({"faults": [""]}, "faults") == []
    assert texts({"faults": ["bias value=1"]}, "faults") == ["bias value=1"]
    with pytest.raises(ValueError, match="faults = 'bias': expected a list of texts"):
        texts({"faults": "bias"}, "faults")


def test_vehicle_is_loaded_by_name():
    assert vehicle_from({"vehicle": "qball_x4"}).name == "qball_x4"
    with pytest.raises(ValueError, match="no vehicle 'qball'"):
        vehicle_from({"vehicle": "qball"})
