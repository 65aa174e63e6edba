"""ArduPilot's JSON interface: packets as published, axes, flights of SITL, bad packets, and the node."""

import json
import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadftc_model.frames import ned_frd_from_enu_flu
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.ardupilot import ArduPilotPhysics, read_servos, rotor_speeds
from quadftc_sim.ardupilot_backend_node import ArduPilotBackendNode
from quadftc_sim.assembly import injection_from, simulator_from
from quadftc_sim.injector import FaultInjector
from quadftc_sim.sensors import GRADES
from wired_node import Wired

VEHICLE = load_vehicle("x500")
RATE = 400  # Hz
# as the readme lists it: uint16 magic = 18458, uint16 frame_rate, uint32 frame_count, uint16 pwm[16]
PUBLISHED = bytes.fromhex("1a48 9001 07000000 e803 dc05 d007 4c04" + " 0000" * 12)
NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # of east, north, up
FRD_OF_FLU = np.diag([1.0, -1.0, -1.0])  # of forward, left, up


def packet(count, pwm=1000, rate=RATE, magic=18458, channels=16):
    return struct.pack(f"<HHI{channels}H", magic, rate, count, *[pwm] * channels)


def physics(*faults, asked=None, **changes):
    values = {"vehicle": "x500", "plant": "free_flight", "start": [5.0, 2.0, 0.123], "seed": 1, **changes}
    injections = [injection_from(fault, len(VEHICLE.rotors.positions)) for fault in faults]
    return ArduPilotPhysics(
        lambda rate: simulator_from({**values, "rate": rate}), lambda: FaultInjector(1, injections), asked
    )


def state_of(line):
    """What SITL reads in a line; its parser wants a line break before and behind."""
    assert line.startswith(b"\n")
    assert line.endswith(b"}\n")
    assert b" " not in line  # its scanf finds no bracket behind a blank
    return json.loads(line)


def hover_pwm(share=1.0):
    return round(1000.0 + 1000.0 * np.sqrt(share) * VEHICLE.hover_speed / VEHICLE.rotors.speed_max)


def flown(made, count, pwm, first=0):
    """Answers to so many packets."""
    return [state_of(made.answer(packet(first + index, pwm))) for index in range(count)]


def test_servo_packet_is_read_as_published():
    found = read_servos(PUBLISHED)
    assert (found.frame_rate, found.frame_count) == (400, 7)
    assert found.pwm == (1000, 1500, 2000, 1100, *[0] * 12)


def test_servo_packet_of_32_channels_is_read_as_published():
    data = bytes.fromhex("8173 e803 ffffffff") + bytes([0xE8, 0x03]) * 32
    assert read_servos(data) == (1000, 2**32 - 1, (1000,) * 32)


def test_pulses_ask_for_speeds_that_the_rotors_have():
    least, most = VEHICLE.rotors.speed_min, VEHICLE.rotors.speed_max
    assert rotor_speeds(VEHICLE, (1000, 1500, 2100, 0)).tolist() == [least, 0.5 * most, most, least]


@given(st.tuples(*[st.floats(-1.5, 1.5)] * 3))
def test_attitude_turns_to_the_axes_of_ardupilot(angles):
    ours = quaternion_from_euler(np.array(angles))
    w, *xyz = ned_frd_from_enu_flu(ours)
    expected = NED_OF_ENU @ Rotation.from_quat(ours).as_matrix() @ FRD_OF_FLU
    np.testing.assert_allclose(Rotation.from_quat([*xyz, w]).as_matrix(), expected, atol=1e-12)


def test_vehicle_at_rest_says_so_in_the_axes_of_ardupilot():
    state = flown(physics(), 400, 1000)[-1]
    np.testing.assert_allclose(state["imu"]["accel_body"], [0.0, 0.0, -STANDARD_GRAVITY], atol=0.01)
    np.testing.assert_allclose(state["imu"]["gyro"], 0.0, atol=1e-3)
    np.testing.assert_allclose(state["position"][:2], [2.0, 5.0], atol=1e-3)  # north, east
    w, *xyz = state["quaternion"]
    np.testing.assert_allclose(
        Rotation.from_quat([*xyz, w]).apply([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], atol=1e-3
    )


def test_vehicle_climbs_by_its_excess_thrust():
    states = flown(physics(start=[0.0, 0.0, 10.0]), 2 * RATE + 1, hover_pwm(1.2))
    share = (hover_pwm(1.2) - 1000.0) ** 2 / (hover_pwm() - 1000.0) ** 2  # in whole microseconds
    assert states[-1]["timestamp"] == pytest.approx(2.0)
    assert states[RATE // 2]["imu"]["accel_body"][2] == pytest.approx(-share * STANDARD_GRAVITY, rel=0.01)
    climb = np.diff([state["position"][2] for state in states])
    velocity = [state["velocity"][2] for state in states]
    assert velocity[-1] < -3.0  # down is positive
    np.testing.assert_allclose(climb * RATE, np.mean([velocity[1:], velocity[:-1]], axis=0), atol=1e-4)


def test_rotors_on_the_right_roll_it_to_the_left():
    made = physics(start=[0.0, 0.0, 10.0])
    hover = hover_pwm()
    pulses = [hover + 20 * (y < 0.0) for y in VEHICLE.rotors.positions[:, 1]] + [0] * 12
    for count in range(40):
        state = state_of(made.answer(struct.pack("<HHI16H", 18458, RATE, count, *pulses)))
    assert state["imu"]["gyro"][0] < -0.1  # forward, right, down: to the left is negative
    assert np.abs(state["imu"]["gyro"][1:]).max() < 0.05


def test_fault_is_in_what_sitl_gets():
    faults = (
        "bias channel=gyro axes=y value=0.3rad/s start=0.5s",
        "bias channel=accelerometer axes=z value=1",
    )
    healthy, faulty = (flown(made, RATE, 1000)[-1]["imu"] for made in (physics(), physics(*faults)))
    np.testing.assert_allclose(np.subtract(faulty["gyro"], healthy["gyro"]), [0.0, -0.3, 0.0], atol=1e-12)
    added = np.subtract(faulty["accel_body"], healthy["accel_body"])
    np.testing.assert_allclose(added, [0.0, 0.0, -1.0], atol=1e-12)


def test_rotor_that_loses_half_its_thrust_turns_the_vehicle():
    made = physics("loss rotors=[1] value=0.5 start=0.25s", start=[0.0, 0.0, 10.0])
    gyro = np.array([state["imu"]["gyro"] for state in flown(made, 160, hover_pwm())])
    x, y = VEHICLE.rotors.positions[0, :2]
    np.testing.assert_allclose(gyro[:100], 0.0, atol=0.01)
    # it falls to the side of the weak rotor: forward, right, down
    assert gyro[-1, 0] * -y > 0.5 * abs(y)
    assert gyro[-1, 1] * -x > 0.5 * abs(x)


@pytest.mark.parametrize("fault", ["dropout channel=imu start=0.25s", "nan channel=gyro start=0.25s"])
def test_sample_that_is_absent_has_the_last_value(fault):
    made = physics(fault, **{"imu.gyro_noise": 0.01})
    gyro = [state["imu"]["gyro"] for state in flown(made, 200, 1000)]
    assert len({tuple(each) for each in gyro[:100]}) == 100
    assert len({tuple(each) for each in gyro[100:]}) == 1
    assert gyro[100] == gyro[99]


@pytest.mark.parametrize(
    ("data", "field"),
    [
        (b"", "length"),
        (PUBLISHED[:7], "length"),
        (PUBLISHED[:-1], "length"),
        (PUBLISHED + b"\0", "length"),
        (packet(1, magic=29569), "length"),
        (packet(1, magic=18459), "magic"),
        (PUBLISHED[::-1], "magic"),
        (packet(1, rate=0), "frame_rate"),
    ],
)
def test_bad_packet_is_counted_and_changes_nothing(data, field):
    made, other = physics(), physics()
    flown(made, 3, 1500), flown(other, 3, 1500)
    assert made.answer(data) is None
    assert made.counts == {field: 1}
    assert made.complaint.startswith(f"{field}: ")
    assert made.answer(packet(3, 1500)) == other.answer(packet(3, 1500))


def test_packet_that_comes_again_is_answered_only_if_the_answer_was_lost(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("quadftc_sim.ardupilot.time.monotonic", lambda: now[0])
    made = physics()
    flown(made, 5, 1500)
    line, now[0] = made.answer(packet(5, 1500)), 3.0  # it took long, and SITL asked again meanwhile
    made.sent()
    for _ in range(2):
        assert made.answer(packet(5, 1500)) is None  # else SITL would be a frame behind for good
    now[0] = 4.1
    assert made.answer(packet(5, 1500)) == line
    assert made.counts == {"frame_count repeated": 3}
    assert state_of(made.answer(packet(6, 1500)))["timestamp"] == pytest.approx(6 / RATE)


def test_each_packet_says_how_long_its_period_is():
    made, falling = physics(start=[0.0, 0.0, 50.0], **{"imu.delay": 2}), 1000
    rates = [1200, *range(1200, 1100, -1), *[100] * 100]
    states, stamps = [], []
    for count, rate in enumerate(rates):
        states.append(state_of(made.answer(packet(count, falling, rate=rate))))
        stamps.append(made.shown.emission.sample_stamp_ns)
    times = np.cumsum([0.0, *(1.0 / rate for rate in rates[1:])])
    np.testing.assert_allclose([state["timestamp"] for state in states], times, atol=1e-6)
    # the state goes on: climb is velocity over the period; the IMU, two samples late, has their stamps
    climb, down = (np.array([state[name][2] for state in states]) for name in ("position", "velocity"))
    np.testing.assert_allclose(np.diff(climb), 0.5 * (down[1:] + down[:-1]) * np.diff(times), atol=1e-4)
    np.testing.assert_allclose(np.subtract(stamps[2:], stamps[2]) * 1e-9, times[:-2], atol=1e-6)


def test_rate_that_is_asked_for_is_flown_whatever_packets_say():
    made = physics(asked=400.0)
    for count, rate in enumerate([1200, 1200, 200, 201]):
        state = state_of(made.answer(packet(count, 1000, rate=rate)))
        assert state["timestamp"] == pytest.approx(count / 400.0)


def test_skipped_packets_are_counted():
    made = physics()
    flown(made, 2, 1500)
    made.answer(packet(5, 1500))
    assert made.counts == {"frame_count skipped": 3}


def test_sitl_that_restarts_begins_a_new_flight():
    made = physics("bias channel=gyro axes=x value=1rad/s start=0.1s")
    first = flown(made, 100, 1900)
    assert first[-1]["imu"]["gyro"][0] == pytest.approx(1.0, abs=0.2)
    assert flown(made, 100, 1900) == first
    assert made.flights == 2


@pytest.fixture
def node():
    with Wired(
        ArduPilotBackendNode,
        "realtime",
        port=0,
        faults=["bias channel=gyro axes=x value=0.5"],
        imu_grade="ideal",
    ) as made:
        yield made


def published_by(node, count):
    """What the node has published when so many samples are complete, by topic; after the answer to SITL."""
    published = {}
    for _ in range(1000):
        for topic, message in node.take():
            published.setdefault(topic, []).append(message)
        if len(published.get("wind/applied", [])) == count:
            break
        time.sleep(0.01)
    return published


def test_node_answers_sitl_and_publishes_what_it_gets(node):
    sitl = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sitl.settimeout(10.0)
    lines = []
    with sitl:
        for data in (b"noise", packet(0), packet(1), packet(2)):
            sitl.sendto(data, ("127.0.0.1", node.node.port))
            lines += [] if data == b"noise" else [state_of(sitl.recv(2048))]
    assert [line["timestamp"] for line in lines] == pytest.approx([0.0, 1 / RATE, 2 / RATE])
    assert lines[-1]["imu"]["gyro"][0] == pytest.approx(0.5, abs=1e-3)
    assert lines[0]["position"][2] == pytest.approx(-0.5 * 0.246, abs=1e-3)  # it stands on the ground
    published = published_by(node, 3)
    assert len(published["plant/odometry"]) == 3
    for topic in ("rotors/command", "torque/command"):  # after the first sample and the second
        stamps = [message.header.stamp for message in published[topic]]
        assert stamps == [message.header.stamp for message in published["imu/data"][:2]]
    assert published["rotors/command"][-1].velocity.tolist() == [VEHICLE.rotors.speed_min] * 4
    assert published["imu/data"][-1].angular_velocity.x == lines[-1]["imu"]["gyro"][0]
    assert published["fault/injected/gyro"][-1].vector.x == pytest.approx(0.5)
    assert node.node.physics.counts == {"length": 1}


def test_imu_of_the_node_is_a_mems_one_unless_it_is_told_otherwise():
    names = ("imu.gyro_noise", "imu.delay", "imu.accelerometer_noise")
    mems = [GRADES["mems"][name.removeprefix("imu.")] for name in names]
    for chosen, expected in (({}, mems), ({"imu_grade": "ideal"}, [0.0, 0, 0.0])):
        with Wired(ArduPilotBackendNode, "realtime", port=0, **chosen, **{names[2]: 0.5}) as made:
            assert [made.node.get_parameter(name).value for name in names] == [*expected[:2], 0.5]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"plant": "test_stand"}, "plant = 'test_stand': expected one that flies"),
        ({"address": "256.1.1.1"}, "address = '256.1.1.1'"),
        ({"port": 70000}, "port = 70000"),
        ({"faults": ["bais channel=gyro"]}, "no fault 'bais'"),
        ({"imu_grade": "mem"}, "imu_grade = 'mem': expected one of ideal, mems"),
    ],
)
def test_wrong_parameter_is_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        Wired(ArduPilotBackendNode, "realtime", **{"port": 0, **wrong})
