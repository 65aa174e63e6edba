# pyright: basic
"""A PX4 log (ULog) as a flight log.

| signal | topic.field: the first that is there |
|---|---|
| gyro | ``sensor_combined.gyro_rad`` or ``vehicle_angular_velocity.xyz``, the faster |
| other gyros, accelerometers | ``vehicle_imu``, ``sensor_gyro``, ``sensor_accel`` of other instances |
| accelerometer | ``sensor_combined.accelerometer_m_s2`` or ``vehicle_acceleration.xyz``, the faster |
| magnetometers | ``vehicle_magnetometer.magnetometer_ga`` of each instance, else ``sensor_mag`` |
| barometers | ``vehicle_air_data.baro_alt_meter``, other ``sensor_baro.pressure`` |
| attitude | ``vehicle_attitude.q`` |
| position, velocity, acceleration | ``vehicle_local_position`` |
| satellites | ``vehicle_gps_position``, else ``sensor_gps``: position, velocity, fix, ``eph`` |
| events | messages, ``failure_detector_status``, ``estimator_selector_status``, resets of the attitude |
| rotor speeds | ``esc_status.esc[].esc_rpm`` |
| rotor commands | ``actuator_motors.control``, else ``actuator_outputs.output`` over its range |
| limits | ``estimator_status.*_test_ratio``, ``cpuload.load``, ``system_power.voltage5v_v``, dropouts |
| torque, thrust command | ``vehicle_torque_``, ``vehicle_thrust_setpoint``; else ``actuator_controls_0`` |
| battery | ``battery_status.voltage_v`` |
| vibration, clips | ``vehicle_imu_status.accel_vibration_metric``, ``accel_clipping`` of the first IMU |
| layout of the rotors | ``CA_ROTOR*_PX``, ``PY``, ``KM``; else the airframe ``SYS_AUTOSTART`` |

Stamps are those of the sensor sample (``timestamp_sample`` where there is one), since the start of the
system. PX4's frames are north-east-down and forward-right-down; `frames` turns them. The attitude is PX4's
own estimate, to which this gyro has contributed. Torque and thrust commands are shares of the greatest.

Source: PX4/PX4-Autopilot, msg/*.msg, src/modules/control_allocator.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadftc_bags.bag import BagError
from quadftc_model.frames import enu_flu_from_ned_frd, enu_from_ned, flu_from_frd
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_replay.flight_log import FlightLog, Floats
from quadftc_replay.readers.layouts import Layout, frame_layout
from quadftc_replay.readers.signals import RPM, Signals, sound, thrust_of_throttle
from quadftc_replay.readers.ulog_datasets import Dataset, fields_of, stamps_of, vectors
from quadftc_replay.readers.ulog_navigation import NAVIGATION, add_navigation
from quadftc_replay.thinning import Messages

FORMAT = "PX4 ULog"

GYROS = {"sensor_combined": "gyro_rad", "vehicle_angular_velocity": "xyz"}
FORCES = {"sensor_combined": "accelerometer_m_s2", "vehicle_acceleration": "xyz"}
# of each instance: topic -> fields, period of integration [µs]
INSTANCES = {
    "gyros": {"vehicle_imu": ("delta_angle", "delta_angle_dt"), "sensor_gyro": ("", "")},
    "accelerometers": {"vehicle_imu": ("delta_velocity", "delta_velocity_dt"), "sensor_accel": ("", "")},
}
ATTITUDE, POSITION = "vehicle_attitude", "vehicle_local_position"
MOTORS, OUTPUTS, ESCS, BATTERY = "actuator_motors", "actuator_outputs", "esc_status", "battery_status"
TORQUE, THRUST, CONTROLS = "vehicle_torque_setpoint", "vehicle_thrust_setpoint", "actuator_controls_0"
SELECTION, IMU_STATUS = "sensor_selection", "vehicle_imu_status"
ESTIMATOR, PROCESSOR, POWER = "estimator_status", "cpuload", "system_power"
# innovation over what the estimator accepts
RATIOS = {"vel": "velocity", "pos": "position", "hgt": "height", "mag": "magnetic field", "tas": "airspeed"}
BOARD_VOLTAGE = 4.7  # V; PX4's arming check
BUSY = 0.95  # 1; of the processor's time
TWICE = re.compile(r"^(\[\w+\])\s+(?=\1)")  # the name of a module, before a text that begins with it
DETECTOR, SELECTOR = "failure_detector_status", "estimator_selector_status"
TOPICS = (
    *(ATTITUDE, POSITION, MOTORS, OUTPUTS, ESCS, BATTERY, TORQUE, THRUST, CONTROLS, SELECTION),
    *(IMU_STATUS, ESTIMATOR, PROCESSOR, POWER),
    *(*NAVIGATION, DETECTOR, SELECTOR),
    *dict.fromkeys([*GYROS, *FORCES, *INSTANCES["gyros"], *INSTANCES["accelerometers"]]),
)
INVALID_TIME = 0x7FFFFFFF  # sensor_combined.accelerometer_timestamp_relative: no accelerometer in this sample
LEAST_RATE = 20.0  # Hz; slower instances are PX4's spot checks of sensors that do not fly the vehicle
HEADER = 3  # bytes of a message before its content
FIRST_MOTOR = 101  # actuator output function of motor 1
MAX_MOTORS = 12
CAN_FULL = 8191.0  # output to an ESC on a CAN bus at full thrust
MAX_PULSE = 2500.0  # µs; greater outputs are of another kind
ROTORS_OF_TYPE = {2: 4, 13: 6, 14: 8, 15: 3, 29: 12}  # MAV_TYPE -> rotors
# thousands of SYS_AUTOSTART -> rotors, frame
AIRFRAMES = {4: (4, "x"), 5: (4, "plus"), 6: (6, "x"), 7: (6, "plus"), 8: (8, "x"), 9: (8, "plus")}
SHOWN = 5  # resets in one note


class Contents(NamedTuple):
    """What is needed of a log."""

    data: dict[tuple[str, int], Dataset]  # topic and instance, with a sample or more
    parameters: Mapping[str, float]
    corrupt: bool
    notes: tuple[str, ...]  # one line each
    messages: tuple[tuple[int, str], ...] = ()  # stamp [ns], text
    dropouts_s: float = 0.0  # that the logger lost [s]

    def get(self, topic: str, instance: int = 0) -> Dataset | None:
        """Samples of a topic."""
        return self.data.get((topic, instance))

    def instances(self, topic: str) -> list[int]:
        """Instances of a topic that have samples."""
        return sorted(instance for name, instance in self.data if name == topic)


def read(path: Path) -> FlightLog:
    """Read a log; BagError if it is none, or if nothing in it can be used."""
    log = read_contents(path)
    signals = Signals(path, FORMAT)
    signals.notes += log.notes
    if log.corrupt:
        signals.notes.append("damaged; read what makes sense")
    _add_main(signals, log, "gyros", GYROS)
    _add_main(signals, log, "accelerometers", FORCES)
    for field, topics in INSTANCES.items():
        _add_others(signals, log, field, topics)
    _add_states(signals, log)
    add_navigation(signals, log.data)
    _add_events(signals, log)
    rotors = _add_rotors(signals, log)
    _add_setpoints(signals, log)
    return signals.flight_log(_layout(log.parameters, rotors), is_own=True, torque_unit="1")


class _Watched(io.BufferedReader):
    """A file that notes when it has less than was asked for: the library passes over that."""

    is_short = False

    def read(self, size: int | None = -1, /) -> bytes:
        """Read bytes."""
        data = super().read(size)
        if size is not None and len(data) < size:  # nothing at all is the end, where a message would begin
            self.is_short = self.is_short or bool(data) or size != HEADER
        return data


def read_contents(path: Path) -> Contents:
    """Read the topics; BagError if the file is no log."""
    from pyulog import ULog  # takes its time, and is needed here only

    buffers: dict[str, Messages] = {}

    class Thinned(ULog):
        """The library's reader, which keeps no more messages of a topic than make sense."""

        class _MessageAddLogged(ULog._MessageAddLogged):
            def __init__(self, *content: Any) -> None:
                super().__init__(*content)
                self.buffer = buffers[f"{self.message_name}[{self.multi_id}]"] = Messages()

    try:
        with path.open("rb", 0) as file, contextlib.redirect_stdout(io.StringIO()):  # the library prints
            stream = _Watched(file)
            log = Thinned(stream, list(TOPICS))
    except OSError as error:
        raise BagError(f"{path}: {error.strerror or error}") from None
    except MemoryError:
        raise
    except Exception as error:  # whatever the library makes of bytes that are no log
        words = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"{path}: not a PX4 log (ULog): {words}") from None
    filled = [each for each in log.data_list if len(each.data.get("timestamp", ()))]
    data = {(each.name, each.multi_id): each.data for each in filled}
    notes = [note for name, each in buffers.items() for note in each.thinning.notes(name)]
    if stream.is_short:
        notes.append("cut short: the log ends within a message")
    messages = tuple((int(each.timestamp) * 1000, str(each.message)) for each in log.logged_messages)
    lost = sum(float(each.duration) for each in log.dropouts) / 1000.0
    return Contents(data, sound(log.initial_parameters), log.file_corruption, tuple(notes), messages, lost)


def _add_main(signals: Signals, log: Contents, field: str, topics: Mapping[str, str]) -> None:
    """Add the sensor that flies the vehicle, from the topic that has most samples."""
    there = [name for name in topics if (data := log.get(name)) and f"{topics[name]}[0]" in data]
    for name in sorted(there, key=lambda each: -len(log.data[each, 0]["timestamp"])):
        data = log.data[name, 0]
        value = vectors(data, topics[name])
        stamp_ns = stamps_of(data)
        relative = data.get("accelerometer_timestamp_relative")
        if value is not None and field == "accelerometers" and relative is not None:
            missing = relative == INVALID_TIME
            value = np.where(missing[:, None], np.nan, value)
            stamp_ns = stamp_ns + np.where(missing, 0, relative.astype(np.int64)) * 1000
        if value is not None and signals.add(field, stamp_ns, flu_from_frd(value), name):
            return


def _add_others(signals: Signals, log: Contents, field: str, topics: Mapping[str, tuple[str, str]]) -> None:
    """Add the other sensors of a kind, each from the topic that has most samples of it."""
    key = "gyro_device_id" if field == "gyros" else "accel_device_id"
    selection = log.get(SELECTION)  # which device flew the vehicle at the end
    main = int(selection[key][-1]) if selection and key in selection else None
    slow: list[str] = []
    for instance in sorted({number for topic in topics for number in log.instances(topic)}):
        there = [topic for topic in topics if (topic, instance) in log.data]
        topic = max(there, key=lambda each: len(log.data[each, instance]["timestamp"]))
        data = log.data[topic, instance]
        name, (element, period) = f"{topic}[{instance}]", topics[topic]
        device = data.get(key, data.get("device_id"))
        is_main = device is not None and main is not None and int(device[0]) == main
        if signals.has(field) and (is_main or (main is None and instance == 0)):
            continue  # the main one, at first hand
        steps = np.diff(stamps_of(data))
        if not len(steps) or not 0 < np.median(steps) <= NANOSECONDS_PER_SECOND / LEAST_RATE:
            slow.append(name)
            continue
        value = vectors(data, element) if element else fields_of(data, "x", "y", "z")
        if value is not None and period:
            with np.errstate(divide="ignore", invalid="ignore"):
                value = value / (1e-6 * data[period].astype(np.float64))[:, None]
        if value is not None:
            signals.add(field, stamps_of(data), flu_from_frd(value), name, str(instance))
    if slow:
        signals.notes.append(f"other {field}, slower than {LEAST_RATE:g} Hz, left out: {', '.join(slow)}")


def _add_states(signals: Signals, log: Contents) -> None:
    if data := log.get(ATTITUDE):
        if (q_wxyz := vectors(data, "q", 4)) is not None:
            signals.add("attitude", stamps_of(data), enu_flu_from_ned_frd(q_wxyz), ATTITUDE)
        signals.notes += _resets(data)
    if data := log.get(POSITION):
        fields = {"position": "x y z", "velocity": "vx vy vz", "acceleration": "ax ay az"}
        for field, names in fields.items():
            if (value := fields_of(data, *names.split())) is not None:
                signals.add(field, stamps_of(data), enu_from_ned(value), f"{POSITION}: {names}")
    if (data := log.get(BATTERY)) and "voltage_v" in data:
        signals.add("battery", stamps_of(data), data["voltage_v"], BATTERY)
    if (data := log.get(IMU_STATUS)) and "accel_vibration_metric" in data:
        level = data["accel_vibration_metric"] / math.sqrt(3.0)
        signals.add("vibration", stamps_of(data), level, IMU_STATUS)
        if (clips := vectors(data, "accel_clipping")) is not None:
            signals.add("clips", stamps_of(data), clips.sum(axis=1), IMU_STATUS)
    _watch(signals, log)


def _watch(signals: Signals, log: Contents) -> None:
    if data := log.get(ESTIMATOR):
        for field, name in RATIOS.items():
            if (ratio := data.get(f"{field}_test_ratio")) is not None:
                signals.watch(f"EKF innovation of the {name}", stamps_of(data), ratio, 1.0)
    if (data := log.get(PROCESSOR)) and "load" in data:
        signals.watch("load of the processor", stamps_of(data), data["load"], BUSY)
    if (data := log.get(POWER)) and "voltage5v_v" in data and np.all(data["voltage5v_v"] > 0.0):
        signals.watch("board voltage", stamps_of(data), data["voltage5v_v"], BOARD_VOLTAGE, "V", True)
    if log.dropouts_s > 0.0:
        signals.notes.append(f"the logger lost {log.dropouts_s:.2g} s in all")


def _add_events(signals: Signals, log: Contents) -> None:
    said = [(stamp, "message", TWICE.sub("", text)) for stamp, text in log.messages]
    if data := log.get(DETECTOR):
        for name in (each for each in data if each.startswith(("fd_", "motor_failure_mask"))):
            said += [(stamp, DETECTOR, f"{name} {value}") for stamp, value in _changes(data, name) if value]
    if data := log.get(SELECTOR):
        name = "primary_instance"
        said += [(stamp, SELECTOR, f"{name} {value}") for stamp, value in _changes(data, name)]
    if data := log.get(ATTITUDE):
        resets = _changes(data, "quat_reset_counter")
        said += [(stamp, ATTITUDE, "the estimator reset it") for stamp, _ in resets]
    for stamp, source, text in sorted(said):
        signals.say(stamp, source, text)


def _changes(data: Dataset, field: str) -> Iterator[tuple[int, int]]:
    """Stamp [ns] and new value of a whole number, whenever it changes."""
    if field in data:
        value, stamp_ns = data[field].astype(np.int64), stamps_of(data)
        for row in np.flatnonzero(np.diff(value)) + 1:
            yield int(stamp_ns[row]), int(value[row])


def _add_setpoints(signals: Signals, log: Contents) -> None:
    if (data := log.get(TORQUE)) and (value := vectors(data, "xyz")) is not None:
        signals.add("torque_command", stamps_of(data), flu_from_frd(value), TORQUE)
    elif (data := log.get(CONTROLS)) and (value := vectors(data, "control")) is not None:
        signals.add("torque_command", stamps_of(data), flu_from_frd(value), CONTROLS)
    if (data := log.get(THRUST)) and "xyz[2]" in data:
        signals.add("thrust_command", stamps_of(data), -data["xyz[2]"], THRUST)
    elif (data := log.get(CONTROLS)) and "control[3]" in data:
        signals.add("thrust_command", stamps_of(data), data["control[3]"], CONTROLS)


def _add_rotors(signals: Signals, log: Contents) -> int:
    """Add speeds and commands of the rotors; return how many there are, 0 if that is not known."""
    kind = int(log.parameters.get("MAV_TYPE", 0))
    count = int(log.parameters.get("CA_ROTOR_COUNT", 0))
    count = count if 0 < count <= MAX_MOTORS else ROTORS_OF_TYPE.get(kind, 0)
    if (data := log.get(MOTORS)) and (value := vectors(data, "control", MAX_MOTORS)) is not None:
        used = np.flatnonzero(np.isfinite(value).any(axis=0))
        count = count or (int(used[-1]) + 1 if len(used) else 0)
        signals.add("rotor_commands", stamps_of(data), value[:, :count], MOTORS)
    elif count:
        _add_outputs(signals, log, count)
    if count and (data := log.get(ESCS)):
        speeds = np.full((len(data["timestamp"]), count), np.nan)
        for k in range(count):
            function = data.get(f"esc[{k}].actuator_function")
            motor = int(function[-1]) - FIRST_MOTOR if function is not None else k
            motor = motor if 0 <= motor < count else k
            if (rpm := data.get(f"esc[{k}].esc_rpm")) is not None:
                speeds[:, motor] = np.abs(rpm.astype(np.float64)) * RPM
        if np.nanmax(speeds, initial=0.0) > 0.0:
            signals.add("rotor_speeds", stamps_of(data), speeds, ESCS)
    return count


def _add_outputs(signals: Signals, log: Contents, count: int) -> None:
    """Add commands of the rotors from the outputs to their ESCs, of the instance that moves most."""
    found: list[tuple[float, int, Floats, str]] = []
    for instance in log.instances(OUTPUTS):
        if (output := vectors(log.data[OUTPUTS, instance], "output", count)) is None:
            continue
        low, high, unit = _output_range(log.parameters, output)
        throttle = np.where(output > 0.0, np.clip((output - low) / (high - low), 0.0, 1.0), 0.0)
        command = thrust_of_throttle(throttle, log.parameters.get("THR_MDL_FAC", 0.0))
        found.append((float(command.std(axis=0).min()), instance, command, unit))
    if found and (best := max(found, key=lambda each: each[0]))[0] > 0.0:
        _, instance, command, unit = best
        stamp_ns = stamps_of(log.data[OUTPUTS, instance])
        signals.add("rotor_commands", stamp_ns, command, f"{OUTPUTS}[{instance}]")
        signals.notes.append(f"rotor commands: from {OUTPUTS}[{instance}], {unit}")


def _output_range(parameters: Mapping[str, float], output: Floats) -> tuple[float, float, str]:
    if output.max() > MAX_PULSE:
        return 0.0, CAN_FULL, f"0 to {CAN_FULL:g}"
    if output.max() <= 1.0:
        return 0.0, 1.0, "0 to 1"
    names = ("PWM_MAIN_{}1", "PWM_MAIN_{}", "PWM_{}")
    ends = [[name.format(end) for name in names] for end in ("MIN", "MAX")]
    low, high = (next((parameters[name] for name in each if name in parameters), 0.0) for each in ends)
    low, high = (low, high) if 0 < low < high else (1000.0, 2000.0)
    return low, high, f"pulses of {low:g} to {high:g} µs"


def _layout(parameters: Mapping[str, float], count: int) -> Layout | None:
    """Where the rotors are: by the control allocation, else by the airframe."""
    names = [[f"CA_ROTOR{k}_{key}" for key in ("PX", "PY", "KM")] for k in range(count)]
    if count and all(name in parameters for row in names for name in row):
        x, y, km = np.array([[parameters[name] for name in row] for row in names], np.float64).T
        if np.any(x) or np.any(y):  # KM > 0: turns counterclockwise, so that it turns the body clockwise
            return Layout(np.stack([x, -y], axis=-1), -np.sign(km))
    if parameters.get("MOT_ORDERING", 0) != 0:
        return frame_layout(count, "betaflight x")
    rotors, frame = AIRFRAMES.get(int(parameters.get("SYS_AUTOSTART", 0)) // 1000, (0, ""))
    return frame_layout(rotors, frame) if rotors == count else None


def _resets(data: Dataset) -> list[str]:
    """Say when PX4's estimator has reset the attitude, after the first one."""
    counter = data.get("quat_reset_counter", np.zeros(1)).astype(np.int64)
    rows = np.flatnonzero(np.diff(counter) != 0) + 1
    if not len(rows):
        return []
    stamp_ns = stamps_of(data)
    times = (stamp_ns[rows] - stamp_ns[0]) / NANOSECONDS_PER_SECOND
    shown = ", ".join(f"{time:.2f} s" for time in times[:SHOWN]) + (", ..." if len(times) > SHOWN else "")
    return [f"the estimator of PX4 has reset the attitude {len(rows)} times, at {shown}: no fault"]
