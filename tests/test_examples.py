"""The examples run: an observer in a package of its own flies, and a batch of flights says how well."""

import ast
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from sensor_msgs.msg import Imu

from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.rotations import euler_from_quaternion

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

# fields of px4_msgs (PX4, BSD-3) that the bridge may use: main of 2026-07-23, and release/1.15 to 1.18
PX4 = {
    "VehicleAttitude": ("timestamp", "timestamp_sample", "q", "delta_q_reset", "quat_reset_counter"),
    "SensorCombined": ("timestamp", "gyro_rad", "accelerometer_timestamp_relative", "accelerometer_m_s2"),
    "VehicleTorqueSetpoint": ("timestamp", "timestamp_sample", "xyz"),
    "VehicleThrustSetpoint": ("timestamp", "timestamp_sample", "xyz"),
    "OffboardControlMode": ("timestamp", "attitude", "body_rate", "thrust_and_torque", "direct_actuator"),
    "ManualControlSetpoint": ("timestamp", "timestamp_sample", "valid", "throttle", "sticks_moving"),
}
FLY = """
import matplotlib.pyplot as plt
import numpy as np
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import find_scenario, load_scenario, with_components, with_duration

scenario = with_duration(load_scenario(find_scenario("paper_faults")), 24.0)
flight = fly(with_components(scenario, observer="washout"), "proposed")
print(np.degrees(np.abs(flight.angles - flight.reference)).max(), np.degrees(np.abs(flight.fault)).max())
"""


def run(*arguments, **options):
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_own_observer_flies_when_only_its_entry_point_names_it(tmp_path):
    package = EXAMPLES / "own_observer"
    run("setup.py", "-q", "egg_info", "--egg-base", tmp_path, cwd=package)  # as colcon build does
    path = os.pathsep.join([str(tmp_path), str(package), os.environ.get("PYTHONPATH", "")])
    error, fault = map(float, run("-c", FLY, env={**os.environ, "PYTHONPATH": path}).split())
    assert fault > 0.9
    assert error < 0.1 * fault


def loaded(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_autopilots_say_the_same_of_a_vehicle_that_rolls_right_and_looks_north():
    half = np.radians(5.0)
    q_wxyz, rate, force = [np.cos(half), np.sin(half), 0.0, 0.0], [0.1, 0.2, 0.3], [0.0, -1.7, -9.66]
    px4 = SimpleNamespace(q=q_wxyz), SimpleNamespace(gyro_rad=rate, accelerometer_m_s2=force)
    sample = loaded(EXAMPLES / "on_your_vehicle" / "px4_bridge.py").sample_of(*px4)
    angles = np.degrees(euler_from_quaternion(sample.q_xyzw))
    assert angles == pytest.approx([10.0, 0.0, 90.0])
    assert sample.body_rate == pytest.approx([0.1, -0.2, -0.3])
    message = Imu()
    for field, names, values in (
        (message.orientation, "xyzw", q_wxyz),
        (message.angular_velocity, "xyz", rate),
        (message.linear_acceleration, "xyz", force),
    ):
        for name, value in zip(names, values, strict=True):
            setattr(field, name, value)
    other = loaded(EXAMPLES / "on_your_vehicle" / "ardupilot_imu.py").sample_of(message, w_first=True)
    for one, two in zip(sample, other, strict=True):
        assert np.allclose(one, two)


def test_px4_bridge_uses_only_fields_that_px4_has(monkeypatch):
    """The node on messages that know no other field; what it sends is there, and within its limits."""
    sent, heard, given = [], {}, {"vehicle": "x500", "limit": 0.2, "thrust_limit": 0.8}
    kinds = {name: px4_message(name, fields) for name, fields in PX4.items()}
    monkeypatch.setitem(sys.modules, "px4_msgs", SimpleNamespace(msg=SimpleNamespace(**kinds)))
    bridge = loaded(EXAMPLES / "on_your_vehicle" / "px4_bridge.py")

    class Node:
        def __init__(self, name): ...
        def declare_parameter(self, name, default): ...
        def get_parameter(self, name):
            return SimpleNamespace(value=given[name])

        def create_publisher(self, kind, topic, qos):
            return SimpleNamespace(msg_type=kind, publish=lambda message: sent.append((topic, message)))

        def create_subscription(self, kind, topic, callback, qos):
            heard[topic] = lambda **fields: callback(kind(**fields))

        def get_clock(self):
            return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=5_000))

    bridge.Px4Bridge.__bases__ = (Node,)
    bridge.Px4Bridge()
    heard["/fmu/out/sensor_combined"](timestamp=1_000, gyro_rad=np.zeros(3), accelerometer_m_s2=np.ones(3))
    heard["/fmu/out/vehicle_attitude"](timestamp_sample=1_000, q=np.array([1.0, 0.0, 0.0, 0.0]))
    heard["/fmu/out/manual_control_setpoint"](throttle=0.0)
    heard["torque/command"](vector=Vector3(x=9.0, y=0.0, z=0.0))
    (imu, _), (_, mode), (_, thrust), (_, torque) = sent
    assert (imu, mode.thrust_and_torque, mode.timestamp) == ("imu/data", True, 5)
    assert [*thrust.xyz, *torque.xyz] == pytest.approx([0.0, 0.0, -0.5, 0.2, 0.0, 0.0])


def px4_message(name, fields):
    """Make a class with these fields and no others, zero until they are given."""

    def start(message, **given):
        for field in fields:
            setattr(message, field, given.pop(field, 0))
        assert not given

    return type(name, (), {"__slots__": fields, "__init__": start})


def test_thrust_follows_the_stick_within_its_limit():
    share = loaded(EXAMPLES / "on_your_vehicle" / "px4_bridge.py").thrust_share
    assert [share(stick, 0.8) for stick in (-1.0, 0.0, 1.0, float("nan"))] == [0.0, 0.5, 0.8, 0.0]


def test_batch_in_ten_lines_flies_each_flight():
    example = loaded(EXAMPLES / "batch_in_ten_lines.py")
    sizes, errors = example.fly(3, "conventional")
    assert len(set(sizes)) == 3
    # without diagnosis the vehicle is off by the fault for a quarter of the flight, and by -2 deg for another
    assert errors == pytest.approx(np.sqrt((sizes**2 + 2.0**2) / 4.0), rel=0.25)


def test_imu_example_names_its_options():
    assert "--bias" in run(EXAMPLES / "own_imu" / "publish_and_listen.py", "--help")


def test_tutorial_still_runs_and_imports_what_there_is(monkeypatch):
    """Cells without the tag ``slow`` run on a shorter flight; of the others, the imports are looked up."""
    monkeypatch.setattr(plt, "show", plt.close)
    assert "reckoner" not in fault_observers.names()  # it registers one
    monkeypatch.setattr(fault_observers, "_components", dict(fault_observers._components))
    notebook = json.loads((EXAMPLES / "tutorial.ipynb").read_text(encoding="utf-8"))
    assert sum(bool(cell.get("outputs")) for cell in notebook["cells"]) == 9  # it was executed
    names: dict[str, object] = {}
    for cell in (each for each in notebook["cells"] if each["cell_type"] == "code"):
        source = "".join(cell["source"]).replace("DURATION = 30.0", "DURATION = 0.2")
        tree = ast.parse(source.replace("range(1500)", "range(20)"))
        if "slow" not in cell["metadata"].get("tags", []):
            exec(compile(tree, cell["id"], "exec"), names)
            continue
        for line in (each for each in tree.body if isinstance(each, ast.ImportFrom)):
            module = ast.parse(Path(importlib.util.find_spec(line.module).origin).read_text(encoding="utf-8"))
            assert {alias.name for alias in line.names} <= {getattr(each, "name", "") for each in module.body}
    assert names["DURATION"] == 0.2
    assert np.degrees(names["estimate"].fault[0]) == pytest.approx(0.0, abs=0.1)
