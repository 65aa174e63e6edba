"""ROS parameters from dataclasses: descriptors, values given at the start, changes at run time."""

import dataclasses
import math
from functools import partial

import pytest
from rclpy.node import Node

from quadftc_model.parameters import build, parameter, parameters_of
from quadftc_ros.parameters import NodeParameters, descriptor


@dataclasses.dataclass(frozen=True)
class Law:
    """One parameter of each type."""

    gain: float = parameter(1.0, unit="1/s", low=0.0, high=10.0, doc="how fast")
    count: int = parameter(3, low=1, high=7, doc="how many")
    open_ended: float = parameter(0.5, unit="s", low=0.0, doc="how long")
    on: bool = parameter(True, doc="whether")
    shape: str = parameter("round", choices=("round", "square"), doc="what it looks like")
    axes: tuple[float, ...] = parameter((1.0, 2.0, 3.0), unit="rad", low=-5.0, high=5.0, doc="of each axis")


class Holder(Node):
    """A node that runs on a law."""

    def __init__(self, **kwargs):
        super().__init__("holder", **kwargs)
        self.declare_parameter("mode", "")  # which the bench gives every node
        self.settings = NodeParameters(self)
        self.settings.declare(Law, "law.")
        self.settings.declare_list("names", "names of things")
        self.law = self.built(self.settings.values())
        self.settings.on_change(self.rebuilt, partial(setattr, self, "law"))

    def built(self, values):
        return build(Law, {name.removeprefix("law."): v for name, v in values.items() if name != "names"})

    def rebuilt(self, values):
        law = self.built(values)
        if law.gain == 7.0 and law.count == 7:
            raise ValueError("law: gain and count must not both be 7")
        return law


def test_descriptor_tells_unit_range_choices_and_meaning(bench):
    bench.run(Holder)
    gain, count, open_ended, shape, axes = (
        bench.describe("holder", f"law.{name}") for name in ("gain", "count", "open_ended", "shape", "axes")
    )
    assert gain.description == "how fast [1/s]"
    assert count.description == "how many"
    assert [(r.from_value, r.to_value) for r in gain.floating_point_range] == [(0.0, 10.0)]
    assert [(r.from_value, r.to_value) for r in count.integer_range] == [(1, 7)]
    assert open_ended.floating_point_range[0].from_value == 0.0
    assert open_ended.floating_point_range[0].to_value > 1e300
    assert shape.additional_constraints == "one of round, square"
    assert axes.additional_constraints == "each within [-5, 5]"
    assert axes.description == "of each axis [rad]"


def test_number_without_bounds_has_no_range():
    @dataclasses.dataclass(frozen=True)
    class Free:
        offset: float = parameter(0.0, unit="rad", doc="how far off")

    (spec,) = parameters_of(Free)
    described = descriptor(spec)
    assert (list(described.floating_point_range), described.additional_constraints) == ([], "")


@pytest.mark.parametrize("read_only", [True, False])
def test_read_only_is_part_of_the_descriptor(read_only):
    assert {descriptor(spec, read_only).read_only for spec in parameters_of(Law)} == {read_only}


def test_values_given_at_the_start_are_used(bench):
    given = {"law.gain": 2.5, "law.count": 7, "law.axes": [0.1, 0.2, 0.3], "names": ["a", "", "b"]}
    node = bench.run(Holder, **given)
    assert node.law == Law(gain=2.5, count=7, axes=(0.1, 0.2, 0.3))
    assert node.settings.values()["names"] == ["a", "b"]


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        (
            "law.gain",
            3,
            r"law.gain = 3: expected a number with a decimal point, as 3.0 \(to ROS, 3 is another",
        ),
        ("law.gain", "3 1/s", "law.gain = '3 1/s': expected a number with a decimal point"),
        ("law.gain", 10.5, r"law.gain = 10.5 1/s: must be within \[0, 10\]"),
        ("law.gain", math.nan, "law.gain: nan: expected a number in 1/s, not NaN"),
        ("law.open_ended", math.inf, "law.open_ended = inf s: must be finite"),
        ("law.count", 3.0, "law.count = 3.0: expected a whole number"),
        ("law.count", 0, r"law.count = 0: must be within \[1, 7\]"),
        ("law.on", "yes", "law.on = 'yes': expected true or false"),
        ("law.shape", "flat", "law.shape = 'flat': expected one of round, square"),
        ("law.axes", [1, 2, 3], r"law.axes = \[1, 2, 3\]: expected three numbers with decimal points"),
        ("law.axes", [1.0, 2.0], r"law.axes: \[1.0, 2.0\]: expected one number or 3, in rad"),
        ("law.axes", [1.0, 2.0, 6.0], r"law.axes = 6.0 rad: must be within \[-5, 5\]"),
        ("names", "one", r"names = 'one': expected a list of texts \(none: \[''\]\)"),
    ],
)
def test_wrong_value_at_the_start_is_refused_in_one_line_that_names_it(bench, name, value, text):
    with pytest.raises(ValueError, match=text) as caught:
        bench.run(Holder, **{name: value})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("law.gain", 9.5),
        ("law.count", 1),
        ("law.on", False),
        ("law.shape", "square"),
        ("law.axes", [0.5] * 3),
    ],
)
def test_change_at_run_time_is_put_to_use(bench, name, value):
    node = bench.run(Holder)
    result = bench.set_parameter("holder", name, value)
    assert (result.successful, result.reason) == (True, "")
    used = getattr(node.law, name.removeprefix("law."))
    assert (list(used) if isinstance(used, tuple) else used) == value


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("law.gain", 11.0, ("law.gain", "10")),
        ("law.gain", -0.1, ("law.gain", "0")),
        ("law.gain", math.nan, ("law.gain",)),
        ("law.gain", 5, ("DOUBLE",)),
        ("law.count", 8, ("law.count", "7")),
        ("law.shape", "flat", ("shape", "one of round, square")),
        ("law.axes", [9.0, 0.0, 0.0], ("axes", "[-5, 5]")),
        ("law.axes", [0.0, 0.0], ("axes", "expected one number or 3")),
        ("names", ["new"], ("read-only",)),
        ("law.nothing", 1.0, ("undeclared",)),
    ],
)
def test_wrong_change_is_refused_with_the_bound_and_the_old_value_stays(bench, name, value, words):
    node = bench.run(Holder)
    before = node.law
    result = bench.set_parameter("holder", name, value)
    assert not result.successful
    assert all(word in result.reason for word in words), result.reason
    assert node.law == before == node.built(node.settings.values())


def test_change_that_only_the_law_refuses_leaves_the_next_one_free(bench):
    node = bench.run(Holder, **{"law.count": 7})
    refused = bench.set_parameter("holder", "law.gain", 7.0)
    assert (refused.successful, refused.reason) == (False, "law: gain and count must not both be 7")
    assert node.law.gain == 1.0
    assert bench.set_parameter("holder", "law.gain", 6.0).successful
    assert node.law.gain == 6.0


def test_name_that_is_no_parameter_is_reported_with_the_nearest(bench):
    node = bench.run(Holder, **{"law.gian": 2.0, "qos_overrides./a.publisher.depth": 1})
    assert node.settings.unknown() == [
        "parameter 'law.gian' was given, but this node has none of that name (did you mean 'law.gain'?)"
    ]


def test_parameters_of_ros_itself_are_no_strangers(bench):
    node = bench.run(Holder, use_sim_time=True)
    assert node.settings.unknown() == []
