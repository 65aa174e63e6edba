"""What a vehicle can do: messages that say more are of no use, whoever sends them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from quadftc_model.arrays import Components
from quadftc_model.samples import MAX_BODY_RATE, AttitudeCommand
from quadftc_model.vehicle import Vehicle

SLACK = 1.1  # 1; what is true of the vehicle differs from its file by less
MAX_ANGLE = 2.0 * np.pi  # rad; of a reference, whose heading may be more than half a turn

Limit = Callable[[Any], bool]  # whether what was decoded is more than a vehicle can do; false for NaN


def limits_of(vehicle: Vehicle) -> Mapping[str, Limit]:
    """Return the limits of what is read, by topic.

    Torques stay within the authority. A disturbance beyond it could not be flown against. Speeds are those of
    the rotors. Angles and rates of a reference are such that a gyro measures.
    """
    torque = partial(_beyond, SLACK * vehicle.authority)
    acceleration = partial(_beyond, SLACK * vehicle.authority / vehicle.inertia)
    speed, rate = partial(_beyond, SLACK * vehicle.rotors.speed_max), partial(_beyond, MAX_BODY_RATE)
    return {
        "torque/command": torque,
        "disturbance/estimate": acceleration,
        "disturbance/kept": acceleration,
        "rotors/command": speed,
        "rotors/speed": speed,
        "gyro/bias": rate,
        "gyro/kept": rate,
        "attitude/reference": _beyond_reference,
    }


def _beyond(most: Components | float, numbers: Components) -> bool:
    return bool(np.any(np.abs(numbers) > most))


def _beyond_reference(command: AttitudeCommand) -> bool:
    angles, rates, _ = command.attitude
    return _beyond(MAX_ANGLE, angles) or _beyond(MAX_BODY_RATE, rates)
