"""What a guardian does about a diagnosis, and when it does nothing."""

import socket
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_model.samples import FAULTY, RECOVERING, ComponentFault, DiagnosisReport
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_sitl.guardian import Guardian
from quadftc_sitl.guardian_node import GuardianNode
from quadftc_sitl.plan import Guard
from wired_node import Wired

SECOND = 1_000_000_000  # ns
ACTIONS = {"gyro": "land", "gyro z": "tell", "attitude": "land", "rotor": "alt_hold", "accelerometer": "rtl"}


def fault(name, *rivals, state=FAULTY):
    component, element = name.split()
    return ComponentFault(component, element, "offset", state, 0.3, -1.0, "rad/s", 1.0, rivals, 0)


def report(at, *faults):
    return DiagnosisReport(round(at * SECOND), (), faults)


def hear(reports, mode="GUIDED", **keys):
    """Let a new guardian hear reports; return what it asks for with the time of each, and all decisions."""
    guardian = Guardian(Guard(actions=ACTIONS, **keys))
    asked = [guardian.step(each, mode) for each in reports]
    return [(round(each.time, 3), each.action) for each in asked if each], guardian.decisions


def every_tenth(first, last, *faults):
    return [report(tenth / 10, *faults) for tenth in range(first, last)]


def test_fault_is_acted_on_once_after_it_was_named_for_the_time():
    assert hear(every_tenth(10, 30, fault("gyro x")))[0] == [(1.3, "land")]
    assert hear(every_tenth(10, 30, fault("gyro z")))[0] == [(1.3, "tell")]  # the element counts first
    assert hear(every_tenth(10, 30))[0] == []


@pytest.mark.parametrize("gap", [[report(1.2)], [report(1.2, fault("gyro x", state=RECOVERING))], []])
def test_fault_that_goes_away_or_is_not_heard_of_has_to_be_named_anew(gap):
    before, after = every_tenth(10, 12, fault("gyro x")), every_tenth(15, 30, fault("gyro x"))
    assert hear([*before, *gap, *after])[0] == [(1.8, "land")]


def test_ambiguous_diagnosis_is_refused_unless_told_otherwise():
    doubtful = every_tenth(10, 20, fault("gyro x", "accelerometer/x"))
    asked, decisions = hear(doubtful)
    assert asked == []
    assert [each.refused for each in decisions] == ["it may be accelerometer x"]
    assert hear(doubtful, ambiguous=True)[0] == [(1.3, "land")]
    assert hear([*doubtful, *every_tenth(20, 22, fault("gyro x"))])[0] == [(2.0, "land")]
    assert hear(every_tenth(10, 20, fault("gyro x", "attitude/roll"), fault("attitude roll")))[0] == [
        (1.3, "land")
    ]
    asked, decisions = hear(every_tenth(10, 20, fault("rotor 1"), fault("gyro y")))
    assert asked == []
    assert decisions[0].refused == "it may be gyro y"


def test_only_a_stronger_mode_follows_and_a_pilot_is_left_alone():
    rotor, gyro = fault("rotor 1"), fault("gyro x")
    both = [*every_tenth(10, 20, rotor), *every_tenth(20, 30, gyro)]
    assert hear(both)[0] == [(1.3, "alt_hold"), (2.3, "land")]
    asked, decisions = hear([*every_tenth(10, 20, gyro), *every_tenth(20, 30, rotor)])
    assert asked == [(1.3, "land")]
    assert decisions[1].refused == "land already"
    assert hear(both, "STABILIZE")[0] == []
    assert hear(both, "LAND")[0] == []


class Autopilot:
    """The other end of the link: says that it is armed, and answers a change of mode."""

    def __init__(self, port):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setblocking(False)
        self.mavlink, self.mode, self.heard = dialect.MAVLink(self, 1, 1), 4, []

    def write(self, data):
        self.socket.send(data)

    def step(self):
        self.mavlink.heartbeat_send(dialect.MAV_TYPE_QUADROTOR, 3, 128, self.mode, 4)
        try:
            while True:
                for message in self.mavlink.parse_buffer(self.socket.recv(2048)) or []:
                    self.heard.append(message)
                    if getattr(message, "command", 0) == dialect.MAV_CMD_DO_SET_MODE:
                        self.mode = int(message.param2)
                        self.mavlink.command_ack_send(message.command, dialect.MAV_RESULT_ACCEPTED)
        except BlockingIOError:
            pass


def test_node_tells_the_autopilot_and_changes_its_mode():
    with Wired(GuardianNode, "realtime", port=0, actions=["gyro=land"], after=0.1) as wired:
        node, wire = wired.node, DiagnosisWire()
        autopilot = Autopilot(node.link.port)
        end = time.monotonic() + 10.0
        autopilot.step()
        while autopilot.mode != 9 and time.monotonic() < end:
            node.look()
            wired.feed("diagnosis", wire(report(node.now_ns() / SECOND, fault("gyro x"))))
            autopilot.step()
            time.sleep(0.02)
        node.look()
        texts = [each.text for each in autopilot.heard if each.get_type() == "STATUSTEXT"]
        autopilot.socket.close()
    assert texts == ["guardian: gyro x offset: land"]
    assert autopilot.mode == 9
    assert not any(each.get_type() == "HEARTBEAT" for each in autopilot.heard)


def test_node_refuses_an_action_that_there_is_not():
    with (
        pytest.raises(ValueError, match="actions: 'fly': expected one of tell"),
        Wired(GuardianNode, "realtime", port=0, actions=["gyro=fly"]),
    ):
        pass
