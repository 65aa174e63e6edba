"""``quadftc export``: what it writes compiles and says what the law says here; and exit codes."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from footprint import CORTEX_M4F, footprint_of, has_compiler
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import Imu

from command_bench import Done, call_quadftc
from message_objects import set_stamp
from quadftc_cli.exporting import KINDS, exported_law, guarded_law
from quadftc_compile.export import FLAGS, write_example, write_law
from quadftc_fdi.observation import ObservationInputs
from quadftc_model.arrays import rows_of
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.stepper import NumpyRunner
from quadftc_replay.plan import read_recording
from quadftc_replay.readers import read_log

COUNT, PERIOD_NS, GAP_NS, FAULTY, GAP = 60, 4_000_000, 2_000_000_000, 30, 50
STRICT = ("-std=c99", *FLAGS, "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror")


def export(*arguments: str | Path) -> Done:
    return call_quadftc("export", *arguments)


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """A recording of an IMU: its attitude steps by 0.2 rad, and there is a gap."""
    folder, store = tmp_path_factory.mktemp("bag") / "imu", get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for row in range(COUNT):
            message, stamp_ns = Imu(), 10**9 + row * PERIOD_NS + (GAP_NS if row >= GAP else 0)
            q = message.orientation
            q.x, q.y, q.z, q.w = quaternion_from_euler(np.array([0.2 * (row >= FAULTY), 0.0, 0.1])).tolist()
            message.angular_velocity.z, message.linear_acceleration.z = 0.001 * row, 9.81
            set_stamp(message.header, stamp_ns)
            writer.write(connection, stamp_ns, serialize_message(message))
    return folder


def test_an_exported_law_says_of_a_recording_what_it_says_here(bag, tmp_path):
    pytest.importorskip("jax")
    samples, folder = tmp_path / "samples.csv", tmp_path / "law"
    assert export("--samples", bag, "--out", samples).returncode == 0
    done = export("sliding_mode", "--vehicle", "qball_x4", "--set", "delta=0.004", "--out", folder)
    assert done.returncode == 0, done.stderr
    assert "qball_x4, the test stand. In double precision" in (folder / "README.md").read_text()
    sources = sorted(each.name for each in folder.glob("*.c"))
    subprocess.run(["cc", *STRICT, *sources, "-lm", "-o", "example"], cwd=folder, check=True)
    told = subprocess.run([folder / "example", samples], capture_output=True, text=True, check=True).stdout
    head, *lines = told.splitlines()
    column = head.split(",").index("said.fault[0]")
    said = [float(line.split(",")[column]) for line in lines]
    wanted = faults_here(bag)
    np.testing.assert_allclose(said, wanted, rtol=1e-9, atol=1e-12)
    assert max(wanted) > 0.1


def faults_here(bag: Path) -> list[float]:
    """Return what the law says of the fault in roll, in NumPy [rad]."""
    law = guarded_law("sliding_mode", "qball_x4", ["delta=0.004"])
    recording, runner, state, said = read_recording(bag), NumpyRunner(law), None, []
    inputs = ObservationInputs(recording.imu, recording.torque, driven=np.bool_(False))
    for row in range(COUNT):
        seen = rows_of(inputs, row)
        if row in (0, GAP):
            state, output = runner.first(seen)
        else:
            state, output = runner.step(state, seen, PERIOD_NS / 1e9)
        said.append(float(output.said.fault[0]))
    return said


@pytest.mark.thorough
@pytest.mark.parametrize("flies", [False, True], ids=["stand", "flight"])
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", sorted({name for kind in KINDS for name in kind.registry.names()}))
def test_every_law_is_exported_without_a_warning(name, real, flies, tmp_path):
    pytest.importorskip("jax")
    exported = exported_law(name, guarded_law(name, "x500", flies=flies), real)
    write_law(exported, tmp_path)
    write_example(exported, tmp_path)
    promoted = ["-Wdouble-promotion"] if real == "float" else []  # INFINITY is a float, in double as well
    for source in sorted(tmp_path.glob("*.c")):
        command = ["cc", *STRICT, *promoted, "-fsyntax-only", source]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:2000]
    if has_compiler() and real == "float":
        assert footprint_of(tmp_path, exported.name, CORTEX_M4F).variables == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["isolatin", "--vehicle", "x500", "--out", "OUT"],
            "no law 'isolatin' (did you mean 'isolating'?); fault observers: ",
        ),
        (["isolating", "--vehicle", "x5oo", "--out", "OUT"], "x5oo"),
        (["isolating", "--out", "OUT"], "expected LAW and --vehicle, or --samples BAG"),
        (["isolating", "--vehicle", "x500"], "Missing option '--out'"),
        (["sliding_mode", "--vehicle", "x500", "--set", "delt=1", "--out", "OUT"], "delt"),
        (["sliding_mode", "--vehicle", "x500", "--set", "delta", "--out", "OUT"], "expected parameter=value"),
        (["sliding_mode", "--vehicle", "x500", "--out", "/proc/law"], "/proc/law"),
        (["sliding_mode", "--vehicle", "x500", "--out", "HERE"], "exists; choose another place, or --force"),
        (["--samples", "nowhere", "--out", "OUT"], "nowhere: no such bag"),
        (["--samples", "BAG", "--vehicle", "x500", "--out", "OUT"], "--samples takes no --vehicle"),
        (["ismc", "--samples", "BAG", "--out", "OUT"], "a recording has no inputs of a controller ('ismc')"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(bag, tmp_path, arguments, words):
    places = {"OUT": tmp_path / "out", "HERE": tmp_path / "here", "BAG": bag}
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "file").touch()
    done = export(*(places.get(word, word) for word in arguments))
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_recording_becomes_an_autopilots_log(autopilot, bag, tmp_path):
    out = tmp_path / "log"
    done = export(bag, "--log", autopilot, "--vehicle", "x500", "--out", out)
    assert done.returncode == 0, done.stderr
    log = read_log(out)
    assert len(log.gyros[""]) > 0
    assert log.rotor_yaw_signs.tolist() == [-1.0, -1.0, 1.0, 1.0]


def test_a_log_takes_no_options_of_a_law(bag, tmp_path):
    done = export(bag, "--log", "px4", "--float", "--out", tmp_path / "log")
    assert done.returncode == 2
    assert "--log takes no --float" in done.stderr
