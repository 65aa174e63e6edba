"""Rotors: the mixer of (2), its inverse, and the torques that a set of rotors can give.

Equation (2) of Wang et al. (2021), for any rotor layout. Rotor i at (x, y) gives the thrust
F = K_i (u_i - u_idle) and the body torque (y F, -x F, reaction torque).
"""

from __future__ import annotations

from quadftc_model.arrays import Components, Scalar, Vector, clip, larger, namespace, sqrt, where
from quadftc_model.vehicle import Vehicle


def torque_from_commands(vehicle: Vehicle, commands: Components) -> Vector:
    """Body torque [N m] (..., 3) of the rotor commands (..., n): the first term of (2)."""
    return commands @ vehicle.mixer.T


def wrench_from_speeds(
    vehicle: Vehicle, speeds: Components, effectiveness: Components | None = None
) -> tuple[Vector, Scalar]:
    """Body torque [N m] (..., 3) and thrust [N] (...) of rotor speeds [rad/s] (..., n).

    ``effectiveness`` (..., n) is the thrust of each rotor over that of a healthy one; None: all are healthy.
    """
    thrusts = vehicle.rotors.thrust_coefficient * speeds * speeds
    if effectiveness is not None:
        thrusts = effectiveness * thrusts
    wrench = thrusts @ vehicle.effectiveness.T
    return wrench[..., 1:], wrench[..., 0]


def commands_from_torque(vehicle: Vehicle, torque: Vector) -> Components:
    """Rotor commands (..., n) for a body torque [N m] (..., 3), around the trim, clipped to their limits."""
    rotors = vehicle.rotors
    commands = rotors.command_trim + torque @ vehicle.allocation.T
    return clip(commands, rotors.command_min, rotors.command_max)


def attainable(vehicle: Vehicle, torque: Vector) -> Vector:
    """Torque [N m] (..., 3) that the rotors can really give, nearest in the sense of flying: tilt before yaw.

    Each axis is held within its authority; then roll and pitch are scaled together into the rotors' room
    around the trim, and yaw gets what room is left. A torque within reach is returned unchanged, bit for bit.
    """
    xp = namespace(torque)
    limited = clip(torque, -vehicle.authority, vehicle.authority)
    allocation = vehicle.allocation.T  # (3, n)
    tilt, yaw = limited[..., :2] @ allocation[:2], limited[..., 2:] * allocation[2]
    room = vehicle.command_room

    tilt_scale = _scale(room, abs(tilt).max(axis=-1, keepdims=True))
    kept = tilt * tilt_scale
    left = room - where(yaw > 0.0, kept, -kept)
    yaw_scale = _scale(left, abs(yaw)).min(axis=-1, keepdims=True)
    scaled = xp.concatenate([limited[..., :2] * tilt_scale, limited[..., 2:] * yaw_scale], axis=-1)
    return where((abs(tilt) + abs(yaw) > room).any(axis=-1, keepdims=True), scaled, limited)


def propeller_speeds(vehicle: Vehicle, commands: Components) -> Components:
    """Speed [rad/s] (..., n) of each propeller, unsigned, from its thrust: F = k Omega²."""
    rotors = vehicle.rotors
    thrust = rotors.thrust_gain * larger(commands - rotors.command_idle, 0.0)
    return sqrt(thrust / rotors.thrust_coefficient)


def _scale(room: Components | float, wanted: Components) -> Components:
    """Factor within [0, 1] that brings ``wanted`` into ``room``; exactly 1 when it fits (to rounding)."""
    room = larger(room, 0.0)  # rounding may leave it below zero
    fits = wanted <= room * (1.0 + 1e-12)
    return where(fits, 1.0, room / where(fits, 1.0, wanted))
