"""Bags of ROS 2 (MCAP) and ROS 1 of a hover, with the bytes that its table gives them."""

from __future__ import annotations

import io
import struct
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as OldWriter
from rosbags.typesys import Stores, get_typestore

from attack.flight_table import COUNT, PERIOD, ROTORS, START, Flight, rotors, rows, vector


def _imu(flight: Flight) -> dict[str, Any]:
    """Fields of `sensor_msgs/Imu` that follow the header."""
    half = 0.5 * vector(flight, "angle")
    return {
        "q": np.column_stack([half, np.ones(COUNT)]),
        "w": vector(flight, "gyro"),
        "a": vector(flight, "force"),
    }


IMU_FIELDS = [
    ("q", "<f8", 4),
    ("qc", "<f8", 9),
    ("w", "<f8", 3),
    ("wc", "<f8", 9),
    ("a", "<f8", 3),
    ("ac", "<f8", 9),
]
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_JAZZY)}
KINDS = ("sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState")


def _joint_names(version: int) -> bytes:
    end = "\0" if version == 2 else ""
    texts = [f"rotor_{number}{end}".encode() for number in ROTORS]
    return struct.pack("<I", len(texts)) + b"".join(struct.pack("<I", len(text)) + text for text in texts)


def _ros_messages(flight: Flight, version: int) -> dict[str, list[bytes]]:
    """Messages of each topic, in CDR (2) or as ROS 1 has them; the sum of their fields' sizes has no gap."""
    clock = START + flight["time"]
    clock = np.where(np.isfinite(clock), clock, 0.0)
    stamp = {"sec": np.floor(clock), "nsec": 1e9 * (clock - np.floor(clock))}
    if version == 2:
        begin = [("cdr", "<u4"), ("sec", "<i4"), ("nsec", "<u4"), ("length", "<u4"), ("frame", "S8")]
        stamp |= {"cdr": 0x0100, "length": 5, "frame": b"base"}
        pad = [("pad", "<u4")]  # numbers of 8 bytes begin at multiples of 8
    else:
        begin = [("seq", "<u4"), ("sec", "<u4"), ("nsec", "<u4"), ("length", "<u4"), ("frame", "S4")]
        stamp |= {"length": 4, "frame": b"base"}
        pad = list[tuple[str, str]]()
    names = _joint_names(version)
    joints = [
        ("names", f"V{len(names)}"),
        ("none", "<u4"),
        ("count", "<u4"),
        ("speed", "<f8", 4),
        ("last", "<u4"),
    ]
    table = {"names": np.void(names), "count": 4, "speed": 1000.0 * rotors(flight)}
    return {
        "/imu/data": rows([*begin, *pad, *IMU_FIELDS], {**stamp, **_imu(flight)}),
        "/rotors/speed": rows([*begin, *joints], {**stamp, **table}),
    }


def mcap(flight: Flight, topics: Mapping[str, str] | None = None) -> bytes:
    """Write a ROS 2 bag; ``topics`` rename topics."""
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    channels = dict[str, int]()
    messages = _ros_messages(flight, 2)
    for topic, kind in zip(messages, KINDS, strict=True):
        text = STORES[2].generate_msgdef(kind, ros_version=2)[0].encode()
        schema = writer.register_schema(kind, "ros2msg", text)
        channels[topic] = writer.register_channel((topics or {}).get(topic, topic), "cdr", schema)
    for k in range(COUNT):
        time = int(1e9 * (START + k * PERIOD))
        for topic, packed in messages.items():
            writer.add_message(channels[topic], time, packed[k], time)
    writer.finish()
    return out.getvalue()


def ros1(flight: Flight) -> bytes:
    """Write a ROS 1 bag of one chunk."""
    messages = _ros_messages(flight, 1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        with OldWriter(path) as writer:
            links = {
                topic: writer.add_connection(topic, kind, typestore=STORES[1])
                for topic, kind in zip(messages, KINDS, strict=True)
            }
            for k in range(COUNT):
                for topic, packed in messages.items():
                    writer.write(links[topic], int(1e9 * (START + k * PERIOD)), packed[k])
        return path.read_bytes()
