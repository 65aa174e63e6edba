"""quadftc inject, clear, set and watch: what they ask nodes for, and what they show."""

from __future__ import annotations

import math
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from message_objects import VectorWriter
from node_bench import imu_message
from quadftc_cli.commands.inject import clear, inject, request_fields
from quadftc_cli.commands.set import parameter_value, set_, setpoint_values
from quadftc_cli.view import POINTS, View, sparkline
from quadftc_control.reference_node import ReferenceNode
from quadftc_sim.fault_injector_node import FaultInjectorNode


def test_fault_becomes_a_request_in_si():
    fields = request_fields("bias axis=roll value=3deg start=1s stop=3s")
    assert fields == {
        "kind": "bias",
        "channel": "attitude",
        "axes": ["roll"],
        "start": 1.0,
        "duration": 2.0,
        "parameter_names": ["value"],
        "parameter_values": [math.radians(3.0)],
    }
    endless = request_fields("sine channel=gyro amplitude=5deg/s frequency=2")
    assert (endless["axes"], endless["duration"]) == ([], 0.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bias value=3", "without a unit this is 172 deg; write value=3deg or value=3rad"),
        ("bias channel=gyro value=-60", "without a unit this is -3438 deg/s; write value=-60deg/s"),
        ("bias value=1deg,2deg,3deg", "value: one number for all axes"),
        ("bais value=1deg", "bias"),
        ("bias value=1dge", "expected rad, deg"),
        ("bias axis=roll", "value: missing; without it, bias is no fault"),
        ("saturation channel=gyro", "limit: missing"),
        ("loss rotor=1 value=20%", "rotor: unknown parameter .did you mean 'rotors'"),
    ],
)
def test_wrong_fault_is_refused_before_it_is_sent(text, words):
    with pytest.raises(ValueError, match=words):
        request_fields(text)


def test_bare_number_is_si_where_that_makes_sense():
    of_rotors = request_fields("loss rotors=[1, 3] value=30% start=1s")
    assert (of_rotors["channel"], of_rotors["axes"]) == ("rotor", ["1", "3"])
    assert of_rotors["parameter_values"] == [0.3]
    assert request_fields("bias value=0.05")["parameter_values"] == [0.05]
    assert request_fields("bias channel=gyro value=0.3")["parameter_values"] == [0.3]


def test_overlaid_fault_without_a_unit_is_asked_about(tmp_path):
    from quadftc_replay.overlay import faults_from

    with pytest.raises(ValueError, match="fault 'bias value=3': value = 3: without a unit this is 172 deg"):
        faults_from((), ["bias value=3"])


def test_setpoint_without_values_is_none(capsys):
    set_("attitude")
    assert "roll=... rad, pitch=... rad, yaw=... rad" in capsys.readouterr().out


def test_setpoint_is_read_with_units():
    assert setpoint_values("attitude", {"roll": "5deg"})["roll"] == pytest.approx(math.radians(5.0))
    with pytest.raises(ValueError, match="yaw = 500deg: must be within -360 to 360 deg"):
        setpoint_values("attitude", {"yaw": "500deg"})
    with pytest.raises(ValueError, match="that is 2865 deg; write 50deg"):
        setpoint_values("attitude", {"roll": "50"})
    for angle in ("95deg", "-95deg"):
        with pytest.raises(ValueError, match=f"roll = {angle}: must be within -80 to 80 deg"):
            setpoint_values("attitude", {"roll": angle})
    assert setpoint_values("attitude", {"yaw": "95deg"})["yaw"] == pytest.approx(math.radians(95.0))
    with pytest.raises(ValueError, match="did you mean 'roll'"):
        setpoint_values("attitude", {"rol": "5deg"})
    with pytest.raises(ValueError, match="z missing"):
        setpoint_values("position", {"x": "1", "y": "2"})


def test_value_of_a_parameter_has_its_type_and_may_have_its_unit():
    number = SimpleNamespace(type=3, description="natural frequency w [rad/s]")
    assert parameter_value("30 deg/s", number).double_value == pytest.approx(math.radians(30.0))
    assert parameter_value("3", number).double_value == 3.0
    three = SimpleNamespace(type=8, description="gains")
    assert list(parameter_value("1,2,3", three).double_array_value) == [1.0, 2.0, 3.0]
    assert parameter_value("4", SimpleNamespace(type=2, description="a count")).integer_value == 4


def test_curve_is_drawn_from_least_to_largest():
    assert sparkline([0.0, 1.0, math.nan, 7.0]) == "▁▂ █"
    assert sparkline([2.0, 2.0]) == "▁▁"


def test_view_shows_what_comes_and_not_what_has_stopped():
    view = View("drone1")
    view.take("imu/data", imu_message(1, angles=(0.1, 0.0, 0.0)), now=10.0)
    estimate = VectorWriter("map")(1, np.radians([3.0, 0.0, 0.0]))
    for k in range(POINTS + 5):
        view.take("fault/estimate", estimate, now=10.0 + 0.25 * k)
    assert "measured 5.73 0.00 0.00" in view.line(10.5)
    late = view.line(10.0 + 0.25 * POINTS)
    assert "measured" not in late
    assert "estimate 3.00 0.00 0.00" in late
    assert "no sample" in view.line(1e3)
    assert len(view.page(11.0).renderables) >= 3


def test_observer_without_states_is_said_to_have_none():
    view = View("drone1")
    view.take("diagnosis", SimpleNamespace(faults=[], watched=[]), now=1.0)
    view.take("imu/data", imu_message(1), now=1.0)
    assert "watched: nothing: no attitude yet, or an observer without states" in view.line(1.0)


@pytest.fixture
def served(bench):
    """Nodes that are served while the test calls commands."""
    bench.run(FaultInjectorNode)
    bench.run(ReferenceNode, source="topic")
    over = threading.Event()

    def serve():
        while not over.is_set():
            bench._executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    yield bench
    over.set()
    thread.join()


def test_fault_is_injected_and_cleared_by_commands(served, capfd):
    inject(["bias", "axis=roll", "value=3deg"])
    clear(1)
    assert capfd.readouterr().out.splitlines() == [
        "fault 1: bias on attitude, until: quadftc clear 1",
        "1 ended",
    ]


def test_wrong_node_is_named_with_those_there_are(served, monkeypatch):
    from quadftc_cli import live
    from quadftc_cli.commands.set import set_
    from quadftc_flight.graph.plan import GraphError

    monkeypatch.setattr(live, "PATIENCE", 0.5)
    with pytest.raises(GraphError, match=r"no node wrong_name in ROS domain .*; there are .*fault_injector"):
        set_("wrong_name", ["setpoint.bandwidth=3"])


def test_vehicle_that_does_not_fly_is_waited_for_once(monkeypatch):
    from quadftc_cli import live
    from quadftc_flight.graph.plan import GraphError

    monkeypatch.setattr(live, "PATIENCE", 0.5)
    begin = time.monotonic()
    with live.LiveGraph("nowhere") as graph, pytest.raises(GraphError, match="controller"):
        graph.choose_vehicle("controller/get_parameters")
    assert time.monotonic() - begin < 0.95


def test_parameter_is_set_by_a_command(served, capfd):
    from quadftc_cli.commands.set import set_

    set_("reference", ["setpoint.bandwidth=2"])
    assert capfd.readouterr().out == "reference: setpoint.bandwidth = 2\n"
    with pytest.raises(ValueError, match="out of range"):
        set_("reference", ["setpoint.bandwidth=0"])


def test_state_of_a_node_is_changed_by_a_command(served, capfd):
    from quadftc_cli.commands.set import set_

    set_("reference", ["lifecycle=deactivate"])
    assert capfd.readouterr().out == "reference: deactivate\n"
    with pytest.raises(ValueError, match="'deactivate': expected one of cleanup, activate, shutdown"):
        set_("reference", ["lifecycle=deactivate"])
