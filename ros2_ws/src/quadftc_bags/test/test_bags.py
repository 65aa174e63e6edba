"""Reading bags: values come back bit for bit, and a bag that is damaged or missing is said so in one line."""

import struct
import tempfile
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Quaternion, Vector3, Vector3Stamped
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Header

from quadftc_bags.bag import Bag, BagError, Series, read_bag
from quadftc_bags.writer import BagWriter
from quadftc_msgs.msg import AttitudeReference, ComponentFault, ControlStatus, Diagnosis, FaultStatus

RELIABLE = QoSProfile(depth=10)

floats = st.floats(width=64)  # with NaN of any payload, infinities, -0.0, subnormals
times = st.builds(Time, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 10**9 - 1))
vectors = st.builds(Vector3, x=floats, y=floats, z=floats)
quaternions = st.builds(Quaternion, x=floats, y=floats, z=floats, w=floats)
frames = st.sampled_from(["", "imu_link", "base_link", "Größe"])
headers = st.builds(Header, stamp=times, frame_id=frames)
covariances = st.lists(floats, min_size=9, max_size=9).map(np.array)
imus = st.builds(
    Imu,
    header=headers,
    orientation=quaternions,
    orientation_covariance=covariances,
    angular_velocity=vectors,
    angular_velocity_covariance=covariances,
    linear_acceleration=vectors,
    linear_acceleration_covariance=covariances,
)
statuses = st.builds(
    FaultStatus,
    header=headers,
    state=st.lists(st.integers(0, 255), min_size=3, max_size=3).map(lambda v: np.array(v, np.uint8)),
    estimate=vectors,
    std_dev=vectors,
    onset=st.lists(times, min_size=3, max_size=3),
)


def write_bag(directory: Path, messages: list, topic: str = "/topic") -> Path:
    """A bag with one topic; message k is logged at k ms."""
    kind = type(messages[0])
    type_name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
    with BagWriter(directory) as writer:
        writer.add_topic(topic, type_name, RELIABLE)
        for number, message in enumerate(messages):
            writer.write(topic, serialize_message(message), number * 1_000_000, number * 1_000_000 + 1)
    return directory


def series_of(messages: list) -> Series:
    with tempfile.TemporaryDirectory() as folder:
        return read_bag(write_bag(Path(folder) / "bag", messages)).series("topic")


def bits(rows: list) -> bytes:
    return np.array(rows, np.float64).tobytes()


def xyz(vector: Vector3) -> list[float]:
    return [vector.x, vector.y, vector.z]


def nanoseconds(time: Time) -> int:
    return time.sec * 1_000_000_000 + time.nanosec


@settings(max_examples=40, deadline=None)
@given(st.lists(imus, min_size=1, max_size=8))
def test_imu_comes_back_bit_for_bit(messages):
    series = series_of(messages)
    q = [[m.orientation.x, m.orientation.y, m.orientation.z, m.orientation.w] for m in messages]
    assert series["orientation_xyzw"].tobytes() == bits(q)
    assert series["orientation_xyzw"].shape == (len(messages), 4)
    for name in ("angular_velocity", "linear_acceleration"):
        assert series[name].tobytes() == bits([xyz(getattr(m, name)) for m in messages])
    for name in ("orientation", "angular_velocity", "linear_acceleration"):
        covariance = f"{name}_covariance"
        assert series[covariance].tobytes() == bits([getattr(m, covariance) for m in messages])
        assert series[covariance].shape == (len(messages), 9)
    assert series.stamp_ns.tolist() == [nanoseconds(m.header.stamp) for m in messages]
    assert series["frame_id"].tolist() == [m.header.frame_id for m in messages]
    assert series.log_time_ns.tolist() == [k * 1_000_000 for k in range(len(messages))]


@settings(max_examples=40, deadline=None)
@given(st.lists(statuses, min_size=1, max_size=8))
def test_fault_status_comes_back_bit_for_bit(messages):
    series = series_of(messages)
    assert series["state"].tolist() == [m.state.tolist() for m in messages]
    assert series["state"].dtype == np.uint8
    for name in ("estimate", "std_dev"):
        assert series[name].tobytes() == bits([xyz(getattr(m, name)) for m in messages])
    assert series["onset_ns"].tolist() == [[nanoseconds(t) for t in m.onset] for m in messages]
    assert series.stamp_ns.tolist() == [nanoseconds(m.header.stamp) for m in messages]


component_faults = st.builds(
    ComponentFault,
    component=st.sampled_from(["attitude", "gyro", ""]),
    element=st.sampled_from(["roll", "x", "Größe"]),
    size=floats,
    ambiguous_with=st.lists(st.sampled_from(["gyro/x", "attitude/roll", ""]), max_size=2),
    onset=times,
)
diagnoses = st.builds(
    Diagnosis,
    header=headers,
    watched=st.lists(st.sampled_from(["attitude", "gyro"]), max_size=2),
    faults=st.lists(component_faults, max_size=3),
)


@settings(max_examples=40, deadline=None)
@given(st.lists(diagnoses, min_size=1, max_size=6))
def test_diagnosis_comes_back_whatever_number_of_faults_it_has(messages):
    series = series_of(messages)
    assert series.stamp_ns.tolist() == [nanoseconds(m.header.stamp) for m in messages]
    assert [list(names) for names in series["watched"]] == [m.watched for m in messages]
    for found, message in zip(series["faults"], messages, strict=True):
        assert len(found) == len(message.faults)
        for fault, wanted in zip(found, message.faults, strict=True):
            assert (fault.component, fault.element) == (wanted.component, wanted.element)
            assert bits([fault.size]) == bits([wanted.size])
            assert list(fault.ambiguous_with) == wanted.ambiguous_with
            assert nanoseconds(fault.onset) == nanoseconds(wanted.onset)


def test_control_status_and_reference_have_their_fields():
    status = ControlStatus(saturated=[True, False, True], mode=3, compute_time=1e-4, error=Vector3(x=0.1))
    series = series_of([status, ControlStatus()])
    assert series["saturated"].dtype == np.bool_
    assert series["saturated"].tolist() == [[True, False, True], [False] * 3]
    assert series["mode"].tolist() == [3, 0]
    assert series["compute_time"].tolist() == [1e-4, 0.0]
    assert series["error"].tolist() == [[0.1, 0.0, 0.0], [0.0] * 3]
    reference = series_of([AttitudeReference(rates=Vector3(z=2.0))])
    assert {name: reference[name].tolist() for name in ("angles", "rates", "accelerations")} == {
        "angles": [[0.0] * 3],
        "rates": [[0.0, 0.0, 2.0]],
        "accelerations": [[0.0] * 3],
    }


def test_odometry_has_its_fields():
    message = Odometry(child_frame_id="base_link")
    message.pose.pose.position.z, message.pose.covariance[0] = 2.0, 0.1
    message.twist.twist.linear.x, message.twist.twist.angular.y = 3.0, 4.0
    series = series_of([message] * 2)
    assert series["child_frame_id"].tolist() == ["base_link"] * 2
    assert series["pose.pose.position"].tolist() == [[0.0, 0.0, 2.0]] * 2
    assert series["pose.pose.orientation_xyzw"].tolist() == [[0.0, 0.0, 0.0, 1.0]] * 2
    assert series["pose.covariance"][:, 0].tolist() == [0.1] * 2
    assert series["twist.twist.linear"].tolist() == [[3.0, 0.0, 0.0]] * 2
    assert series["twist.twist.angular"].tolist() == [[0.0, 4.0, 0.0]] * 2


def test_header_and_clock_give_their_stamps():
    assert series_of([Header(stamp=Time(sec=2, nanosec=5), frame_id="a")]).stamp_ns.tolist() == [
        2_000_000_005
    ]
    clock = series_of([Clock(clock=Time(sec=-1, nanosec=1))])
    assert clock.stamp_ns.tolist() == clock["clock_ns"].tolist() == [-999_999_999]


def test_sequences_of_equal_length_are_matrices_and_others_objects():
    equal = series_of(
        [JointState(name=["a"], position=[1.0, 2.0]), JointState(name=["b"], position=[3.0, 4.0])]
    )
    assert equal["position"].tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert [list(names) for names in equal["name"]] == [["a"], ["b"]]
    ragged = series_of([JointState(position=[1.0, 2.0]), JointState(position=[3.0])])
    assert [row.tolist() for row in ragged["position"]] == [[1.0, 2.0], [3.0]]


def test_diagnostics_are_objects():
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name="n: p", values=[KeyValue(key="k", value="v")])
    series = series_of([DiagnosticArray(), DiagnosticArray(status=[status, status])])
    assert [len(row) for row in series["status"]] == [0, 2]
    assert (series["status"][1][1].name, series["status"][1][1].values[0].value) == ("n: p", "v")


def test_big_endian_messages_are_read(tmp_path):
    values = [(1.5, -2.5, 3.5), (4.0, 5.0, 6.0)]
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/v", "geometry_msgs/msg/Vector3Stamped", RELIABLE)
        for number, value in enumerate(values):
            data = b"\0\0\0\0" + struct.pack(">iII4s3d", number, 7, 4, b"abc", *value)
            writer.write("/v", data, number, number)
    series = read_bag(tmp_path / "bag").series("/v")
    assert series["vector"].tolist() == [list(value) for value in values]
    assert series.stamp_ns.tolist() == [7, 1_000_000_007]
    assert series["frame_id"].tolist() == ["abc", "abc"]


def test_messages_out_of_order_are_sorted_by_log_time(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for topic in ("/a", "/b"):
            writer.add_topic(topic, "std_msgs/msg/Header", RELIABLE)
        for topic, sec in (("/a", 3), ("/b", 2), ("/a", 1)):
            writer.write(topic, serialize_message(Header(stamp=Time(sec=sec))), sec, sec)
    bag = read_bag(tmp_path / "bag")
    assert bag.series("/a").stamp_ns.tolist() == [1_000_000_000, 3_000_000_000]
    expected = [
        (t, sec, serialize_message(Header(stamp=Time(sec=sec))))
        for t, sec in (("/a", 1), ("/b", 2), ("/a", 3))
    ]
    assert list(bag.messages()) == expected
    assert list(bag.messages(["b"])) == expected[1:2]


def test_bag_tells_topics_attachments_and_metadata(tmp_path):
    with BagWriter(tmp_path / "bag", {"scenario.yaml": b"a: 1\n"}, {"quadftc": "0.1.0"}) as writer:
        writer.add_topic("/v", "geometry_msgs/msg/Vector3Stamped", RELIABLE)
        writer.write("/v", serialize_message(Vector3Stamped()), 0, 0)
    for path in (tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"):
        bag = read_bag(path)
        assert bag.attachments == {"scenario.yaml": b"a: 1\n"}
        assert bag.metadata["quadftc"] == {"quadftc": "0.1.0"}
        assert [(t.name, t.type_name, t.count) for t in bag.topics.values()] == [
            ("/v", "geometry_msgs/msg/Vector3Stamped", 1)
        ]
        assert "reliability: reliable" in bag.topics["/v"].qos
        assert not bag.truncated


def test_topic_is_found_by_full_relative_or_short_name(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for name in ("/one/imu/data", "/two/imu/data", "/one/plant/rate"):
            writer.add_topic(name, "std_msgs/msg/Header", RELIABLE)
    bag = read_bag(tmp_path / "bag")
    assert bag.resolve("/one/imu/data") == bag.resolve("one/imu/data") == "/one/imu/data"
    assert bag.resolve("plant/rate") == "/one/plant/rate"
    with pytest.raises(
        BagError, match=r"more than one namespace; topics there: /one/imu/data, /two/imu/data"
    ):
        bag.resolve("imu/data")
    with pytest.raises(
        BagError, match=r"'imu' is not in the bag; topics there: /one/imu/data, /one/plant/rate"
    ):
        bag.resolve("imu")


def test_only_wanted_topics_are_kept(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for name in ("/imu/data", "/plant/rate"):
            writer.add_topic(name, "std_msgs/msg/Header", RELIABLE)
    assert list(read_bag(tmp_path / "bag", ["imu/data"]).topics) == ["/imu/data"]


def test_topic_without_messages_is_an_empty_series(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/imu/data", "sensor_msgs/msg/Imu", RELIABLE)
    series = read_bag(tmp_path / "bag").series("imu/data")
    assert (len(series), series.stamp_ns.shape) == (0, (0,))
    with pytest.raises(BagError, match="topic '/imu/data' has no field 'orientation_xyzw'"):
        series["orientation_xyzw"]


@pytest.fixture(scope="module")
def chunked_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of a bag with 10 chunks of 50 messages."""
    directory = tmp_path_factory.mktemp("chunks") / "bag"
    with BagWriter(directory, {"note.txt": b"note"}) as writer:
        writer.add_topic("/v", "geometry_msgs/msg/Vector3Stamped", RELIABLE)
        for number in range(500):
            message = Vector3Stamped(vector=Vector3(x=float(number)))
            writer.write("/v", serialize_message(message), number, number)
            if number % 50 == 49:
                assert writer.flush()
    return (directory / "bag_0.mcap").read_bytes()


def read_bytes(data: bytes) -> Bag:
    with tempfile.NamedTemporaryFile(suffix=".mcap") as file:
        file.write(data)
        file.flush()
        return read_bag(file.name)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_file_cut_anywhere_gives_what_came_before(chunked_file, data):
    end = data.draw(st.integers(8, len(chunked_file) - 30))
    bag = read_bytes(chunked_file[:end])
    assert bag.truncated
    if bag.topics:
        count = bag.topics["/v"].count
        assert count % 50 == 0
        assert list(bag.series("/v").fields.get("vector", np.empty((0, 3)))[:, 0]) == list(range(count))


def test_file_cut_in_its_last_chunk_has_all_others(chunked_file):
    whole = read_bytes(chunked_file)
    assert (whole.truncated, whole.topics["/v"].count) == (False, 500)
    # The summary begins with the data's end; before it stand the last chunk and its index.
    half = read_bytes(chunked_file[: int(len(chunked_file) * 0.5)])
    assert half.truncated
    assert 100 <= half.topics["/v"].count <= 400
    assert half.attachments == {"note.txt": b"note"}


def test_damaged_chunk_ends_the_reading(chunked_file):
    middle = len(chunked_file) // 2
    damaged = chunked_file[:middle] + bytes(200) + chunked_file[middle + 200 :]
    bag = read_bytes(damaged)
    assert bag.truncated
    count = bag.topics["/v"].count
    assert 0 < count < 500
    assert list(bag.series("/v")["vector"][:, 0]) == list(range(count))


def test_footer_that_is_larger_than_the_file_is_damage(chunked_file):
    at = len(chunked_file) - 36  # behind its opcode
    bag = read_bytes(chunked_file[:at] + struct.pack("<Q", 2**63) + chunked_file[at + 8 :])
    assert (bag.truncated, bag.topics["/v"].count) == (True, 500)


def test_file_without_chunks_is_read(tmp_path):
    path = tmp_path / "plain.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start("ros2")
        definition = b"builtin_interfaces/Time stamp\nstring frame_id\n" + b"=" * 80
        definition += b"\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        schema = writer.register_schema("std_msgs/msg/Header", "ros2msg", definition)
        channel = writer.register_channel("/h", "cdr", schema)
        for sec in range(3):
            writer.add_message(channel, sec, serialize_message(Header(stamp=Time(sec=sec))), sec)
        writer.finish()
    assert read_bag(path).series("h").stamp_ns.tolist() == [0, 1_000_000_000, 2_000_000_000]


def test_channel_of_another_encoding_is_named_when_asked_for(tmp_path):
    path = tmp_path / "json.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("thing", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/j", "json", schema), 0, b"{}", 0)
        writer.finish()
    with pytest.raises(BagError, match="topic '/j' cannot be decoded: message encoding 'json', expected cdr"):
        read_bag(path).series("/j")


def test_message_shorter_than_its_type_is_an_error(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/v", "geometry_msgs/msg/Vector3Stamped", RELIABLE)
        writer.write("/v", serialize_message(Vector3Stamped())[:-8], 0, 0)
    with pytest.raises(
        BagError, match="topic '/v' cannot be decoded: a message of 36 bytes is no geometry_msgs"
    ):
        read_bag(tmp_path / "bag").series("/v")


def test_split_bag_is_read_in_the_order_of_its_metadata(tmp_path):
    for part in (0, 1):
        write_bag(tmp_path / f"part{part}", [Header(stamp=Time(sec=part))])
        (tmp_path / f"part{part}" / f"part{part}_0.mcap").rename(tmp_path / f"bag_{part}.mcap")
    text = "rosbag2_bagfile_information:\n  relative_file_paths: [bag_1.mcap, bag_0.mcap]\n"
    (tmp_path / "metadata.yaml").write_text(text)
    assert read_bag(tmp_path).series("topic").stamp_ns.tolist() == [1_000_000_000, 0]


@pytest.mark.parametrize(
    ("files", "path", "text"),
    [
        ({}, "none", "none: no such bag"),
        ({}, ".", "no bag in this directory"),
        ({"a.mcap": ""}, "a.mcap", "a.mcap: empty file"),
        ({"a.mcap": ""}, ".", "a.mcap: empty file"),
        ({"a.mcap": "this is a text"}, "a.mcap", "a.mcap: not an MCAP file"),
        ({"metadata.yaml": "{"}, ".", "metadata.yaml: not the metadata of a bag"),
        ({"metadata.yaml": "other: 1"}, ".", "metadata.yaml: not the metadata of a bag"),
        (
            {"metadata.yaml": "rosbag2_bagfile_information: {relative_file_paths: [b.mcap]}"},
            ".",
            "metadata.yaml names b.mcap, which is missing",
        ),
        (
            {"metadata.yaml": "rosbag2_bagfile_information: {relative_file_paths: [b.db3]}", "b.db3": "x"},
            ".",
            "not a bag that can be read",
        ),
        (
            {"metadata.yaml": "rosbag2_bagfile_information: {compression_mode: FILE}"},
            ".",
            "compressed by file; unpack it",
        ),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line(tmp_path, files, path, text):
    for name, content in files.items():
        (tmp_path / name).write_text(content)
    with pytest.raises(BagError, match=text) as caught:
        read_bag(tmp_path / path)
    assert "\n" not in str(caught.value)
