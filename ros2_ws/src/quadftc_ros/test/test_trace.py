"""The trace of a node: times of its messages by topic and stamp, there when the node has ended."""

from __future__ import annotations

import time

from geometry_msgs.msg import Vector3Stamped
from rclpy.parameter import Parameter

from quadftc_ros.node import GraphNode
from quadftc_ros.transport import MessageTrace, load_trace


def test_times_are_read_back_in_order(tmp_path):
    trace = MessageTrace()
    taken, given = trace.noting("taken imu/data"), trace.noting("given imu/corrected")
    begin = time.monotonic_ns()
    for stamp in (3, 5, 8):
        taken(stamp)
        given(stamp)
    end = time.monotonic_ns()
    trace.noting("taken torque/command")
    trace.save(tmp_path / "trace.npz")
    found = load_trace(tmp_path / "trace.npz")
    assert set(found) == {"taken imu/data", "given imu/corrected", "taken torque/command"}
    assert found["taken imu/data"][:, 0].tolist() == [3, 5, 8]
    times = found["given imu/corrected"][:, 1]
    assert begin <= times[0] <= times[-1] <= end
    assert (found["taken imu/data"][:, 1] <= times).all()
    assert found["taken torque/command"].shape == (0, 2)


def test_node_traces_what_it_gives(lockstep_bench, tmp_path):
    path = tmp_path / "plant.npz"
    overrides = [Parameter("mode", value="lockstep"), Parameter("trace", value=str(path))]
    node = GraphNode("plant", context=lockstep_bench.context, parameter_overrides=overrides)
    publish = node.publishes("plant/rate")
    node.ready()
    message = Vector3Stamped()
    for sec in (1, 2):
        message.header.stamp.sec = sec
        publish(message)
    node.destroy_node()
    rows = load_trace(path)["given plant/rate"]
    assert rows[:, 0].tolist() == [1_000_000_000, 2_000_000_000]


def test_trace_that_cannot_be_written_is_reported_and_the_node_ends(lockstep_bench, tmp_path, capfd):
    path = tmp_path / "missing" / "plant.npz"
    overrides = [Parameter("mode", value="lockstep"), Parameter("trace", value=str(path))]
    node = GraphNode("plant", context=lockstep_bench.context, parameter_overrides=overrides)
    node.ready()
    node.destroy_node()
    assert "No such file or directory" in capfd.readouterr().err
