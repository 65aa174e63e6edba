"""Serialised messages are the same for the same values, whatever stood in memory between their fields."""

import functools

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Vector3, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from sensor_msgs.msg import Imu, JointState, NavSatFix
from std_msgs.msg import Header

from quadftc_bags.cdr.layout import PaddingCleaner
from quadftc_bags.interfaces import load_interface
from quadftc_msgs.msg import AttitudeReference, ComponentFault, ControlStatus, Diagnosis, FaultStatus

HEADER = Header(stamp=Time(sec=3, nanosec=7), frame_id="imu_link")
STATUS = DiagnosticStatus(name="a: b", message="odd", values=[KeyValue(key="k", value="v"), KeyValue()])
GYRO = ComponentFault(component="gyro", element="x", size=0.3, unit="rad/s", ambiguous_with=["attitude/roll"])
MESSAGES = [
    Imu(header=HEADER),
    Vector3Stamped(header=HEADER, vector=Vector3(x=1.0)),
    FaultStatus(header=HEADER, onset=[Time(sec=1), Time(), Time(nanosec=2)]),
    AttitudeReference(header=HEADER),
    ControlStatus(header=HEADER, mode=2, compute_time=1e-4),
    Diagnosis(header=HEADER, watched=["attitude", "gyro"], faults=[GYRO, ComponentFault(kind="noise"), GYRO]),
    Diagnosis(header=HEADER),
    HEADER,
    DiagnosticArray(header=HEADER, status=[STATUS, DiagnosticStatus(), STATUS]),
    JointState(header=HEADER, name=["a", "bcd"], position=[1.0, 2.0]),
    JointState(header=HEADER, name=["rotor_1", "rotor_2"], velocity=[1.0, 2.0]),
    Odometry(header=HEADER, child_frame_id="base_link"),
    NavSatFix(header=HEADER),
]


def type_name(message: object) -> str:
    kind = type(message)
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


@functools.cache
def store_of(name: str) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(load_interface(name).text, name))
    return store


def canonical(message: object, data: bytes) -> bytes:
    """What the rosbags library, which writes zeros between fields, makes of the values in ``data``."""
    name = type_name(message)
    store = store_of(name)
    definition = store.get_msgdef(name)
    values, _ = definition.deserialize_cdr_le(data[4:], 0, definition.cls, store)
    return bytes(store.serialize_cdr(values, name))


def soiled(message: object, data: bytes) -> bytes:
    """The message with rubbish in each byte that means nothing."""
    clean = canonical(message, data)
    rubbish = bytearray(data)
    for position in range(4, len(clean)):
        changed = data[:position] + bytes([data[position] ^ 0xA5]) + data[position + 1 :]
        try:
            meaningless = canonical(message, changed) == clean
        except Exception:  # a length or a text that makes no sense: the byte means something
            meaningless = False
        if meaningless:
            rubbish[position] ^= 0xA5
    return bytes(rubbish) + b"rubbish"


@pytest.mark.parametrize("message", MESSAGES, ids=type_name)
def test_cleaned_message_is_canonical(message):
    data = serialize_message(message)
    dirty = soiled(message, data)
    cleaner = PaddingCleaner(type_name(message))
    for _ in range(2):  # the second time with the shape known
        assert cleaner.clean(dirty) == canonical(message, data)


def test_padding_is_really_soiled():
    data = serialize_message(Imu(header=HEADER))
    dirty = soiled(Imu(header=HEADER), data)
    assert [position for position in range(len(data)) if dirty[position] != data[position]] == [25, 26, 27]


def test_shape_is_found_anew_when_a_length_changes():
    cleaner = PaddingCleaner("geometry_msgs/msg/Vector3Stamped")
    for frame in ("abc", "abcde", "", "abc"):
        message = Vector3Stamped(header=Header(frame_id=frame))
        data = serialize_message(message)
        assert cleaner.clean(soiled(message, data)) == canonical(message, data)


@pytest.mark.parametrize("size", [4, 10, 40])
def test_message_that_does_not_fit_its_type_is_left_alone(size):
    data = serialize_message(Imu(header=HEADER))[:size]
    assert PaddingCleaner("sensor_msgs/msg/Imu").clean(data) == data
