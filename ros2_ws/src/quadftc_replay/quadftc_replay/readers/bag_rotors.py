"""Rotors in a ROS 2 bag: measured speeds and commands, of whatever message carries one value for each.

Topics that end in ``rotors/speed`` and ``rotors/command`` come first, else those whose names say so, such
as ``motor_speeds`` or ``esc/rpm``. Of `sensor_msgs/JointState` the first of velocity, effort and position is
taken, ordered by the numbers at the end of the joints' names. Of `actuator_msgs/Actuators` and
`mav_msgs/Actuators` it is velocity, else normalized; of arrays the data, at the times of recording.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from quadftc_model.arrays import AnyArray
from quadftc_model.vehicle import Vehicle
from quadftc_replay.readers.bag_columns import Choose, Columns, is_named, trailing_number
from quadftc_replay.readers.signals import RPM, Signals

JOINTS, ACTUATORS = "sensor_msgs/msg/JointState", "actuator_msgs/msg/Actuators"
MAV_ACTUATORS = "mav_msgs/msg/Actuators"  # of ROS 1
ARRAYS = ("std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float32MultiArray")
SPEEDS, COMMANDS = "rotors/speed", "rotors/command"
ROTORS = r"(rotor|motor|propeller|prop|esc)s?[_/]?"
IS_SPEED = re.compile(rf"{ROTORS}(\w*[_/])?(speed|velocit|rpm|omega|state|feedback|telemetry)", re.IGNORECASE)
IS_COMMAND = re.compile(
    rf"{ROTORS}(\w*[_/])?(command|cmd|setpoint|reference|throttle|thrust|pwm)", re.IGNORECASE
)
ASKED = re.compile(r"command|cmd|setpoint|reference|desired|target|throttle|pwm", re.IGNORECASE)
FEWEST, MOST = 3, 16  # rotors


def _first_filled(fields: Columns, names: tuple[str, ...]) -> Columns:
    """Keep the first of some fields that has one value for each rotor."""
    for name in names:
        value: AnyArray = fields.get(name, np.zeros(0))
        if value.ndim == 2 and FEWEST <= value.shape[1] <= MOST:
            is_speed = np.full(len(value), name in ("velocity", "angular_velocities", "data"))
            return {"value": value.astype(np.float64), "is_speed": is_speed}
    raise ValueError("no values, or a number of rotors that changes")


def _joints(fields: Columns) -> Columns:
    kept = dict(_first_filled(fields, ("velocity", "effort", "position")))
    names = [str(name) for name in fields["name"][0]]
    numbers = [trailing_number(name) for name in names]
    if len(names) == kept["value"].shape[1] and len({*numbers} - {None}) == len(names):
        kept["value"] = kept["value"][:, np.argsort(np.array(numbers))]
    return kept


CHOOSERS: Mapping[str, Choose] = {
    JOINTS: _joints,
    ACTUATORS: lambda fields: _first_filled(fields, ("velocity", "normalized", "position")),
    MAV_ACTUATORS: lambda fields: _first_filled(fields, ("angular_velocities", "normalized", "angles")),
    **dict.fromkeys(ARRAYS, lambda fields: _first_filled(fields, ("data",))),
}


def find_rotor_choice(name: str, kind: str) -> Choose | None:
    """What is kept of a topic's messages, if it is one of the rotors'."""
    is_rotors = bool(IS_SPEED.search(name) or IS_COMMAND.search(name))
    return CHOOSERS.get(kind) if is_rotors else None


def _best(kinds: Mapping[str, str], data: Mapping[str, Columns], ending: str) -> str:
    """Topic of speeds or commands, by their usual name, else by what the name says; empty: none."""

    def rank(name: str) -> tuple[bool, int]:
        return is_named(name, ending), len(data[name]["stamp_ns"])

    names = [name for name, kind in kinds.items() if kind in CHOOSERS]
    fit = [name for name in names if _is_command(name) == (ending == COMMANDS)]
    return max(fit, key=rank, default="")


def _is_command(name: str) -> bool:
    return ASKED.search(name) is not None or IS_SPEED.search(name) is None


def add_rotors(
    signals: Signals, kinds: Mapping[str, str], data: Mapping[str, Columns], vehicle: Vehicle | None
) -> None:
    """Add measured speeds and commands of the rotors; ``kinds`` and ``data`` are those of the topics."""
    if name := _best(kinds, data, SPEEDS):
        speeds: AnyArray = np.abs(data[name]["value"]) * (RPM if "rpm" in name.lower() else 1.0)
        signals.add("rotor_speeds", data[name]["stamp_ns"], speeds, name)
    if not (name := _best(kinds, data, COMMANDS)):
        return
    command = np.asarray(data[name]["value"], np.float64)
    greatest = float(np.nanmax(np.abs(command), initial=0.0))
    if greatest > 1.0:
        if bool(data[name]["is_speed"][0]):
            greatest = vehicle.rotors.speed_max if vehicle else greatest
            command = (command / greatest) ** 2
            words = f"squares of the commanded speeds over {greatest:.6g} rad/s"
        else:
            command, words = command / greatest, f"shares of the greatest, {greatest:.6g}"
        signals.notes.append(f"{name}: {words}")
    signals.add("rotor_commands", data[name]["stamp_ns"], np.clip(command, 0.0, 1.0), name)
