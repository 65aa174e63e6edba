"""Every parameter of every node refuses what is out of its bounds, at the start and in flight."""

from __future__ import annotations

import math
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rcl_interfaces.msg import ParameterType
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.parameter import Parameter

from quadftc_control.controller import controllers
from quadftc_control.controller_node import ControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode
from wired_node import Wired

NODES = {
    "plant": (PlantNode, {"start_when_connected": False}),
    "fault_injector": (FaultInjectorNode, {}),
    "reference": (ReferenceNode, {}),
    **{f"fault_observer {kind}": (FaultObserverNode, {"observer": kind}) for kind in fault_observers.names()},
    **{
        f"disturbance_observer {kind}": (DisturbanceObserverNode, {"observer": kind})
        for kind in disturbance_observers.names()
    },
    **{f"controller {kind}": (ControllerNode, {"controller": kind}) for kind in controllers.names()},
}
WRONG_TYPES = {
    ParameterType.PARAMETER_DOUBLE: (1, "1.0", True, [1.0], None),
    ParameterType.PARAMETER_INTEGER: (1.0, "1", True, [1], None),
    ParameterType.PARAMETER_BOOL: (1, "true", 1.0, [True], None),
    ParameterType.PARAMETER_STRING: (1, 1.0, True, ["a"], None),
    ParameterType.PARAMETER_DOUBLE_ARRAY: (1.0, [1, 2, 3], ["a"] * 3, "1,2,3", None),
    ParameterType.PARAMETER_STRING_ARRAY: ("a", [1.0], 1, None),
}
NO_NUMBERS = (math.nan, math.inf, -math.inf)


def bad_values(described, present):  # noqa: C901
    """Values that a parameter must refuse, each with words that the refusal has to have."""
    kind = described.type
    found = [(value, ()) for value in WRONG_TYPES[kind]]
    if kind == ParameterType.PARAMETER_DOUBLE:
        found += [(value, ()) for value in NO_NUMBERS if value != present]
        for bounds in described.floating_point_range:
            for bound, beyond in ((bounds.from_value, -math.inf), (bounds.to_value, math.inf)):
                if abs(bound) < sys.float_info.max:
                    found += [
                        (math.nextafter(bound, beyond), ()),
                        (bound + math.copysign(1.0 + abs(bound), beyond), (bound,)),
                    ]
    elif kind == ParameterType.PARAMETER_INTEGER:
        for bounds in described.integer_range:
            found += [
                (value, (bound,))
                for bound, value in ((bounds.from_value, bounds.from_value - 1),)
                if value > -(2**63)
            ]
            if bounds.to_value < 2**63 - 1:
                found.append((bounds.to_value + 1, (bounds.to_value,)))
    elif kind == ParameterType.PARAMETER_DOUBLE_ARRAY:
        found += [([*present[:-1], value], ()) for value in NO_NUMBERS]
        found += [(list(present)[:-1], (3,)), ([1.0] * 1000, (3,)), ([], ())]
        if "each within" in described.additional_constraints:
            low, high = (
                float(word.strip(" []"))
                for word in described.additional_constraints.split("within")[1].split(",")
            )
            found += [
                ([bound * 2.0 + math.copysign(1.0, sign)] * 3, (f"{bound:g}",))
                for bound, sign in ((low, -1), (high, 1))
                if math.isfinite(bound)
            ]
    elif kind == ParameterType.PARAMETER_STRING and described.additional_constraints:
        found += [(value, ("one of",)) for value in ("", "x" * 10_000, "\n", "é")]
    return found


def parameter(name, value):
    """A parameter as a service brings it; None: not set."""
    return Parameter(name, Parameter.Type.NOT_SET) if value is None else Parameter(name, value=value)


@pytest.mark.parametrize("case", NODES)
def test_bad_value_in_flight_is_refused_with_its_bound_and_the_old_one_stays(case):
    node_class, given = NODES[case]
    refused = 0
    with Wired(node_class, "realtime", **given) as wired:
        node = wired.node
        before = node.settings.values()
        for name in before:
            described = node.describe_parameter(name)
            for value, words in bad_values(described, before[name]):
                (result,) = node.set_parameters([parameter(name, value)])
                assert not result.successful, (name, value)
                assert result.reason
                refused += 1
                if not described.read_only:
                    assert all(_word(word) in result.reason for word in words), (name, value, result.reason)
        assert node.settings.values() == before
    assert refused > 20


def _word(word):
    return word if isinstance(word, str) else f"{word:g}"


def start(case, name, value):
    node_class, given = NODES[case]
    context = Context()
    context.init()
    try:
        overrides = [parameter(key, each) for key, each in {**given, name: value}.items()]
        node_class(context=context, parameter_overrides=overrides).destroy_node()
    finally:
        context.try_shutdown()


@pytest.mark.parametrize(
    "case", ["plant", "fault_observer supervised", "disturbance_observer exosystem", "controller ismc"]
)
def test_bad_value_at_the_start_is_refused_by_name(case):
    node_class, given_ = NODES[case]
    with Wired(node_class, "realtime", **given_) as wired:
        values = wired.node.settings.values()
        bad = [
            (name, value)
            for name in values
            for value, _ in bad_values(wired.node.describe_parameter(name), values[name])
            if value is not None
        ]

    @settings(max_examples=settings().max_examples // 3)
    @given(st.sampled_from(bad))
    def refused(pair):
        name, value = pair
        with pytest.raises((ValueError, ParameterException)) as caught:
            start(case, name, value)
        assert name.rpartition(".")[2] in str(caught.value)

    refused()


@pytest.mark.parametrize(
    "case", ["fault_observer supervised", "disturbance_observer exosystem", "controller ismc", "reference"]
)
def test_any_change_is_taken_or_refused_and_never_half(case):
    """Several parameters at once, good and bad: all or nothing of one call."""
    node_class, given_ = NODES[case]
    with Wired(node_class, "realtime", **given_) as wired:
        node = wired.node
        names = [name for name in node.settings.values() if not node.describe_parameter(name).read_only]
        numbers = st.sampled_from(
            [0.0, 1.0, 0.5, 1e-9, 5e-324, 1e300, -1.0, math.nan, math.inf, 3, "a", True, [1.0] * 3, None]
        )

        @settings(max_examples=60)
        @given(st.dictionaries(st.sampled_from(names), numbers, min_size=1, max_size=4))
        def change(values):
            before = node.settings.values()
            result = node.set_parameters_atomically(
                [parameter(name, value) for name, value in values.items()]
            )
            after = node.settings.values()
            if result.successful:
                assert all(after[name] == value for name, value in values.items())
            else:
                assert result.reason
                assert after == before

        change()
