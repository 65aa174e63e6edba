"""Messages of ArduPilot as tables, by the names of dataflash logs, and the rotors that they tell.

``SERVOn_FUNCTION`` says which output drives which motor; without it output n drives motor n. Commands are the
pulses as shares of ``MOT_PWM_MIN`` to ``MOT_PWM_MAX`` (0: of ``RC3_MIN`` to ``RC3_MAX``), and of
``MOT_SPIN_MIN`` to ``MOT_SPIN_MAX`` of that. The linearisation by ``MOT_THST_EXPO`` is undone, but for the
part that depends on the voltage. Speeds of ESCs that report within a few milliseconds make one sample.

Source: ArduPilot, AP_Motors/AP_MotorsMulticopter.cpp, SRV_Channel/SRV_Channel.h.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from quadftc_replay.readers.layouts import Layout, frame_layout
from quadftc_replay.readers.signals import RPM, Signals, Stamps, columns, thrust_of_throttle

Table = Mapping[str, NDArray[np.float64]]  # field to (n,)
LEAST_SHARE = 0.01  # of the messages of the most frequent instance
MAX_TIME = 2.0**62 / 1000.0  # µs
INSTANCES = ("I", "Instance", "Inst", "C", "IMU")  # field that tells instances apart
TOGETHER = 0.005e9  # ns; reports of ESCs within this time are one sample
# SERVOn_FUNCTION -> motor
MOTOR_FUNCTIONS = {33 + k: k for k in range(8)} | {82 + k: 8 + k for k in range(4)}
LEAST_RANGE = 50.0  # µs; the pulses of a motor in flight differ by more
OUTPUTS = 14  # in RCOU; SERVOn_FUNCTION of each is one of these
CLASSES = {1: 4, 2: 6, 3: 8}  # FRAME_CLASS -> rotors
# FRAME_TYPE -> frame; 2 is a V, whose rotors turn as those of an X
_X = {1: "x", 2: "x", 12: "betaflight x", 13: "dji x", 14: "clockwise x", 18: "betaflight x reversed"}
FRAMES = {0: "plus", 3: "h", 6: "plus reversed"} | _X


def instances_of(table: Table | None, *fields: str) -> dict[int, Table]:
    """Split a message by its instance, if it has some fields; all is of instance 0 if it has no instance."""
    if table is None or not {"TimeUS", *fields} <= table.keys():
        return {}
    key = next((name for name in INSTANCES if name in table), None)
    if key is None:
        return {0: table}
    numbers, counts = np.unique(table[key], return_counts=True)
    real = numbers[counts > LEAST_SHARE * counts.max()]  # others are damaged
    return {
        int(number): {name: values[table[key] == number] for name, values in table.items()}
        for number in real.tolist()
    }


def first_of(table: Table | None, *fields: str) -> Table | None:
    """Return the first instance of a message; None if there is none with some fields."""
    found = instances_of(table, *fields)
    return found[min(found)] if found else None


def stamps_of(table: Table) -> Stamps:
    """Time of each message [ns] (n,): when it was sampled, else when it was logged."""
    return np.clip(table.get("SampleUS", table["TimeUS"]), 0.0, MAX_TIME).astype(np.int64) * 1000


def at(stamp_ns: Stamps, table: Table, field: str) -> NDArray[np.float64]:
    """Return a field at other times (n,), straight between messages; beyond them the nearest."""
    times = stamps_of(table)
    order = np.argsort(times, kind="stable")
    return np.interp(stamp_ns, times[order], table[field][order])


def add_rotors(
    signals: Signals, messages: Mapping[str, Table], parameters: Mapping[str, float]
) -> Layout | None:
    """Add commands (``RCOU``) and speeds (``ESC``) of the rotors; return where they are, if that is known."""
    layout, note = _layout(parameters, messages.get("RCOU"))
    signals.notes += note
    motors = _motors(parameters, layout)
    _add_commands(signals, messages, parameters, motors)
    _add_speeds(signals, messages, motors)
    return layout


def _layout(parameters: Mapping[str, float], outputs: Table | None) -> tuple[Layout | None, list[str]]:
    """Where the rotors are, and notes."""
    for prefix in ("", "Q_"):
        kind, form = (parameters.get(f"{prefix}FRAME_{each}") for each in ("CLASS", "TYPE"))
        if kind and form is not None:
            layout = frame_layout(CLASSES.get(int(kind), 0), FRAMES.get(int(form), ""))
            unknown = f"{prefix}FRAME_CLASS {kind:g}, {prefix}FRAME_TYPE {form:g}: this layout is not known"
            return layout, [] if layout else [unknown]
    if "FRAME" in parameters and outputs is not None:  # before Copter 3.5
        pulses = [outputs.get(f"C{k + 1}", np.zeros(1)) for k in range(OUTPUTS)]
        count = int(np.argmin([float(np.ptp(pulse)) > LEAST_RANGE for pulse in pulses]))
        if layout := frame_layout(count, FRAMES.get(int(parameters["FRAME"]), "")):
            return layout, [f"layout of the rotors: by FRAME, and {count} outputs that move"]
    return None, ["no FRAME_CLASS and FRAME_TYPE among the parameters: layout of the rotors not known"]


def _motors(parameters: Mapping[str, float], layout: Layout | None) -> dict[int, int]:
    """Motor of each output, both from 0; without parameters of outputs, as many as the layout has."""
    motors: dict[int, int] = {}
    for output in range(OUTPUTS):
        function = parameters.get(f"SERVO{output + 1}_FUNCTION", 0.0)
        if (motor := MOTOR_FUNCTIONS.get(int(function) if math.isfinite(function) else 0)) is not None:
            motors[output] = motor
    count = len(layout.yaw_signs) if layout else len(motors)
    if sorted(motors.values()) == list(range(count)):
        return motors
    return {output: output for output in range(count)}


def _add_commands(
    signals: Signals,
    messages: Mapping[str, Table],
    parameters: Mapping[str, float],
    motors: Mapping[int, int],
) -> None:
    outputs = [f"C{output + 1}" for output in sorted(motors, key=lambda each: motors[each])]
    table = first_of(messages.get("RCOU"), *outputs)
    if not table or not motors:
        return

    def get(name: str, default: float) -> float:
        return next((parameters[f"{q}{name}"] for q in ("", "Q_") if f"{q}{name}" in parameters), default)

    ranges = [(get(f"{name}_MIN", 0.0), get(f"{name}_MAX", 0.0)) for name in ("MOT_PWM", "RC3")]
    low, high = next((each for each in ranges if 0.0 < each[0] < each[1]), (1000.0, 2000.0))
    spin_min, spin_max = get("MOT_SPIN_MIN", 0.15), get("MOT_SPIN_MAX", 0.95)
    if not 0.0 <= spin_min < spin_max <= 1.0:
        spin_min, spin_max = 0.0, 1.0
    share = (columns(table, outputs) - low) / (high - low)
    throttle = np.clip((share - spin_min) / (spin_max - spin_min), 0.0, 1.0)
    signals.add(
        "rotor_commands", stamps_of(table), thrust_of_throttle(throttle, get("MOT_THST_EXPO", 0.65)), "RCOU"
    )


def _add_speeds(signals: Signals, messages: Mapping[str, Table], motors: Mapping[int, int]) -> None:
    """Add the speeds that the ESCs report, those of about the same time in one sample."""
    table = messages.get("ESC")
    if table is None or not instances_of(table, "RPM") or not motors:
        return
    stamps, key = stamps_of(table), next(name for name in INSTANCES if name in table)
    motor = np.array([motors.get(int(output), -1) for output in table[key].tolist()])
    used = np.flatnonzero(motor >= 0)
    stamps, motor, speed = stamps[used], motor[used], RPM * np.abs(columns(table, ["RPM"])[used, 0])
    rows = group_reports(stamps, motor)
    if not len(rows) or not np.any(speed):
        return
    first = np.flatnonzero(np.diff(rows, prepend=-1))
    value = np.full((len(first), len(motors)), np.nan)
    value[rows, motor] = speed
    signals.add("rotor_speeds", stamps[first], value, "ESC")


def group_reports(stamp_ns: Stamps, motor: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the sample each report belongs to (n,): of different motors, within `TOGETHER`."""
    rows = np.empty(len(stamp_ns), np.int64)
    row, start, seen = -1, 0, set[int]()
    for k, (stamp, number) in enumerate(zip(stamp_ns.tolist(), motor.tolist(), strict=True)):
        if row < 0 or number in seen or not 0 <= stamp - start <= TOGETHER:
            row, start, seen = row + 1, stamp, set[int]()
        seen.add(number)
        rows[k] = row
    return rows
