"""Betaflight's packets, axes and motors, restarts, bad packets, and the node against a small firmware."""

import socket
import struct
import time
from pathlib import Path

import numpy as np
import pytest

import quadftc_model
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.assembly import injection_from, simulator_from
from quadftc_sim.betaflight import EARTH, LATITUDE, LONGITUDE, BetaflightPhysics
from quadftc_sim.betaflight_backend_node import BetaflightBackendNode
from quadftc_sim.injector import FaultInjector
from wired_node import Wired

VEHICLE = load_vehicle("x500")
RATE = 500.0  # Hz
HOVER = VEHICLE.hover_speed / VEHICLE.rotors.speed_max
FIELDS = {"time": 1, "rate": 3, "force": 3, "attitude": 4, "velocity": 3, "place": 3, "pressure": 1}


def physics(*faults, **changes):
    values = {"vehicle": "x500", "plant": "free_flight", "start": [5.0, 2.0, 10.0], "seed": 1, **changes}
    injections = [injection_from(fault, 4) for fault in faults]
    return BetaflightPhysics(
        lambda rate: simulator_from({**values, "rate": rate}), lambda: FaultInjector(1, injections), RATE
    )


def state_of(data):
    """What the firmware reads: target.h, fdm_packet."""
    values = np.split(np.array(struct.unpack("<18d", data)), np.cumsum([*FIELDS.values()])[:-1])
    return dict(zip(FIELDS, values, strict=True))


def flown(made, count, *motors):
    """The state after so many packets of motors: front right, rear left, front left, rear right."""
    for _ in range(count):
        state = made.answer(struct.pack("<4f", *motors), "firmware")
    return state_of(state)


def test_level_vehicle_says_so_in_the_axes_of_betaflight():
    made = physics()
    state = state_of(made.state())
    assert state["time"] == 0.0
    w, x, y, z = state["attitude"]
    assert (x, y, z / w) == pytest.approx((0.0, 0.0, 1.0))  # its nose to the east
    metres = (state["place"] - [LONGITUDE, LATITUDE, 0.0]) * [np.cos(np.radians(LATITUDE)), 1.0, 1.0]
    np.testing.assert_allclose(metres * [*[np.radians(EARTH)] * 2, 1.0], [5.0, 2.0, 10.0], atol=1e-3)
    assert state["pressure"] == pytest.approx(101325.0 - 120.0, abs=1.0)
    hovering = flown(made, 200, *[HOVER] * 4)
    np.testing.assert_allclose(hovering["force"], [0.0, 0.0, -STANDARD_GRAVITY], atol=0.02)
    assert hovering["time"] == pytest.approx(200 / RATE)


@pytest.mark.parametrize(
    ("stronger", "turned"),  # forward, right, down
    [((1, 2), (1.0, 0.0)), ((0, 2), (0.0, 1.0))],
    ids=["left", "front"],
)
def test_motors_turn_it_as_in_the_order_of_betaflight(stronger, turned):
    motors = [HOVER + 0.02 * (index in stronger) for index in range(4)]
    rate = flown(physics(), 50, *motors)["rate"]
    assert rate[:2] / np.linalg.norm(rate[:2]) == pytest.approx(turned, abs=0.05)


def test_fault_is_in_what_the_firmware_gets_and_a_new_one_begins_a_flight():
    made, healthy = physics("bias channel=gyro axes=y value=0.3rad/s"), physics()
    motors = [HOVER] * 4
    added = flown(made, 5, *motors)["rate"] - flown(healthy, 5, *motors)["rate"]
    np.testing.assert_allclose(added, [0.0, -0.3, 0.0], atol=1e-9)
    assert state_of(made.answer(struct.pack("<4f", *motors), "another"))["time"] == 0.0
    assert made.flights == 2


@pytest.mark.parametrize(
    ("data", "field"),
    [(b"", "length"), (bytes(17), "length"), (struct.pack("<4f", *[np.nan] * 4), "motor_speed")],
)
def test_bad_packet_is_counted_and_changes_nothing(data, field):
    made = physics()
    first = made.state()
    assert made.answer(data, "firmware") is None
    assert made.counts == {field: 1}
    assert made.state() == first


@pytest.fixture
def firmware():
    """Node and firmware: its socket for states; motors go from another."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as states:
        states.bind(("127.0.0.1", 0))
        states.settimeout(10.0)
        port = states.getsockname()[1]
        with Wired(BetaflightBackendNode, "realtime", port=0, state_port=port, rate=RATE) as node:
            yield node, states


def test_node_flies_at_the_pace_of_the_wall_and_goes_on_without_an_answer(firmware):
    node, states = firmware
    motors, answered = struct.pack("<4f", *[HOVER] * 4), 100
    begin = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for _ in range(answered):
            state = state_of(states.recv(256))
            out.sendto(motors, ("127.0.0.1", node.node.port))
        assert time.monotonic() - begin > 0.8 * (answered - 1) / RATE
        assert state["time"] == pytest.approx((answered - 1) / RATE, abs=3.0 / RATE)
        while state_of(states.recv(256))["time"] < state["time"] + 0.1:
            assert time.monotonic() - begin < 20.0
    topics = {topic for topic, _ in node.take()}
    assert {"imu/data", "plant/odometry", "rotors/command", "torque/command"} <= topics
    assert node.node.physics.counts["unanswered"] > 0


def test_vehicle_without_four_rotors_is_refused(tmp_path):
    text = (Path(quadftc_model.__file__).parent / "vehicles" / "x500.toml").read_text()
    for old, new in (
        ("[[0.174, -0.174],", "[[0.246, 0.0], [-0.246, 0.0], [0.174, -0.174],"),
        ("[-1, -1, 1, 1]", "[1, -1, -1, -1, 1, 1]"),
        ("[1, 1, -1, -1]", "[-1, 1, 1, 1, -1, -1]"),
    ):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "hexa.toml").write_text(text)
    with pytest.raises(ValueError, match=r"hexa.toml': expected 4 rotors, not 6"):
        Wired(BetaflightBackendNode, "realtime", port=0, vehicle=str(tmp_path / "hexa.toml"))
