"""Good input that bad input is made of: scenarios, campaigns, gains, vehicles, parameters, bags, logs."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as OldWriter
from rosbags.typesys import Stores, get_typestore

from attack.flight_table import hover
from attack.inputs import plain_dump
from attack.logs import ulog
from quadftc_flight.runs import RunOptions, run, run_name
from quadftc_flight.scenario import find_scenario, load_scenario, node_parameters, scenario_names
from quadftc_model import vehicle as vehicles

SCENARIO = b"""\
name: tiny
description: 0.4 s with everything in it
duration: 0.4 s
rate: 250 Hz
seed: 3
vehicle: qball_x4
plant: {motor_lag: true, substeps: 1, inertia_factor: [1.0, 1.1, 0.9]}
sensors: {grade: mems, delay: 1}
references:
  - {kind: sine, amplitude: 5 deg, frequency: 3 rad/s}
  - {kind: step, angles: [5 deg, 0, 0], start: 0.1 s, stop: 0.3 s, rise: 0.05 s}
disturbances:
  - {kind: constant, amplitude: 0.02 N m, start: 0.1 s}
faults:
  - {kind: bias, channel: attitude, axes: roll, value: 1 deg, start: 0.2 s}
  - {kind: noise, channel: gyro, sigma: 0.1, start: 0.1 s, stop: 0.2 s}
  - {kind: dropout, channel: imu, probability: 0.5, start: 0.1 s, duration: 0.05 s}
  - {kind: delay, channel: attitude, start: 0.3 s}
schemes:
  proposed:
    observer: {kind: sliding_mode, epsilon_s: 1.0}
    disturbance_observer: exosystem
    controller: {kind: ismc, k_c1: [1.0, 1.0, 1.0]}
    checks:
      - {metric: tracking_rmse_deg, below: 5}
      - {metric: fault_estimate_max_deg, axis: roll, above: 0, below: 100}
  conventional:
    controller: smc
"""
CAMPAIGN = b"""\
name: tiny_campaign
description: a few flights
scenario: tiny.yaml
gains: gains.yaml
set: [duration=0.35 s, "faults.0.value=2 deg"]
flights: 3
seed: 1
schemes: [proposed]
vary:
  faults.0.value: {uniform: [0.5 deg, 5 deg], sign: random}
  faults.1.sigma: {log_uniform: [0.05, 0.5]}
  rate: {grid: [100 Hz, 250 Hz]}
  plant.inertia_factor: {normal: [1.0, 0.01], size: 3}
  faults.0.axes: {choice: [roll, pitch]}
precision: float64
tune:
  gains: [controller.k_c1, controller.phi, disturbance_observer.bandwidth]
  cost: {tracking_rmse_deg: 1, torque_total_variation: 0.1}
  flights: 2
  steps: 2
  rate: 0.05
  held_out: 2
"""
GAINS = b"""\
vehicle: qball_x4
grade: mems
disturbance_observer: {kind: exosystem, bandwidth: 9.1}
controller: {kind: ismc, k_c1: [14.6, 17.1, 9.9], phi: 0.1}
"""
FAULTS = b"""\
faults:
  - {kind: bias, channel: attitude, axes: [roll, yaw], value: 3 deg, start: 0.1 s, stop: 0.2 s}
  - {kind: spikes, channel: gyro, axis: x, start: 0.1 s, duration: 0.1 s}
"""
NODES = ("plant", "fault_injector", "fault_observer", "disturbance_observer", "controller", "reference")
SCHEME = "proposed"


class Seeds:
    """Makes each good input once, when it is first asked for; flies 0.4 s in a folder for the bag."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @cached_property
    def scenarios(self) -> list[bytes]:
        """Scenario files; the first is short."""
        return [SCENARIO, *(find_scenario(name).read_bytes() for name in scenario_names())]

    @cached_property
    def vehicles(self) -> list[bytes]:
        """Vehicle files."""
        folder = Path(vehicles.__file__).parent / "vehicles"
        return [path.read_bytes() for path in sorted(folder.glob("*.toml"))]

    @cached_property
    def parameters(self) -> dict[str, bytes]:
        """Node to a ROS parameter file with all that the node has."""
        parameters = node_parameters(load_scenario(self._file("tiny.yaml", SCENARIO)), SCHEME)
        return {node: plain_dump({f"/{node}": {"ros__parameters": parameters[node]}}) for node in NODES}

    @cached_property
    def bag(self) -> dict[str, bytes]:
        """A run: its bag and the files beside it, by name."""
        scenario = load_scenario(self._file("tiny.yaml", SCENARIO))
        run(scenario, scenario.scheme(SCHEME), self._folder, RunOptions(), lambda _: True)
        folder = self._folder / run_name(scenario, scenario.scheme(SCHEME))
        return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}

    @cached_property
    def mcap(self) -> str:
        """Name of the MCAP file in `bag`."""
        return next(name for name in self.bag if name.endswith(".mcap"))

    @cached_property
    def loose(self) -> bytes:
        """The bag without compression, sums and attachments: what is overwritten in it is read as it is."""
        source, target = self._file("bag.mcap", self.bag[self.mcap]), self._folder / "loose.mcap"
        with source.open("rb") as stream, target.open("wb") as out:
            reader = make_reader(stream)
            writer = Writer(out, compression=CompressionType.NONE, use_chunking=False, enable_crcs=False)
            writer.start(profile="ros2")
            channels: dict[int, int] = {}
            for schema, channel, message in reader.iter_messages():
                assert schema is not None
                if channel.id not in channels:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(
                        channel.topic, channel.message_encoding, number, channel.metadata
                    )
                times = {"log_time": message.log_time, "publish_time": message.publish_time}
                writer.add_message(
                    channels[channel.id], data=message.data, sequence=message.sequence, **times
                )
            writer.finish()
        return target.read_bytes()

    @cached_property
    def sqlite(self) -> dict[str, bytes]:
        """The IMU of the bag as SQLite, by name."""
        source, folder = self._file("bag.mcap", self.bag[self.mcap]), self._folder / "old"
        store = get_typestore(Stores.ROS2_JAZZY)
        with (
            source.open("rb") as stream,
            OldWriter(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as out,
        ):
            connection = out.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
            for _, _, message in make_reader(stream).iter_messages(topics=["/imu/data"]):
                out.write(connection, message.log_time, message.data)
        return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}

    @cached_property
    def ulog(self) -> bytes:
        """A PX4 log."""
        return ulog(hover())

    def _file(self, name: str, data: bytes) -> Path:
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / name
        path.write_bytes(data)
        return path


def with_vehicle(name: str) -> bytes:
    """The short scenario with another vehicle."""
    return plain_dump({**yaml.safe_load(SCENARIO), "vehicle": name})
