"""What no multirotor can be: each check refuses a vehicle by a number, and says what is possible.

The bounds are wide: every published multirotor is well within them, a slip of unit, sign or digit is not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from quadftc_model.vehicle_table import Problem, shortened

if TYPE_CHECKING:
    from quadftc_model.vehicle import Vehicle

THRUST_TO_WEIGHT = (1.15, 50.0)  # 1; 1.15 carries the weight at a tilt of 30 deg; racing quadrotors reach 15
SINK = 0.9  # 1; share of the weight that the slowest rotors may carry, else the vehicle cannot come down
INDEPENDENCE = 0.02  # 1; share of an axis' torque that must be left when thrust and other torques are held
AGILITY = (1.0, 1.0, 0.1)  # rad/s²; least acceleration in hover: at 0.1 a turn by 90 deg takes 8 s
GYRATION = (0.1, 1.5)  # 1; radius of gyration over that of the rotors; 0.4 to 0.9 are usual
REACH = 15.0  # m; of the rotors from the centre: the largest that carry persons have 6
PLACES = "rotors.positions"
ROTATION_DECAY = 0.02  # s; least time constant of a free rotation; rotors damp with seconds
DRIFT_DECAY = 0.2  # s; least time constant by which rotor drag stops the vehicle; 4 to 10 are usual
TORQUE_ROWS = ("roll", "pitch", "yaw")  # of `Vehicle.effectiveness`, below the thrust
ROUNDING = 1e-9  # 1

Floats = NDArray[np.float64]


class _ImpossibleError(Exception):
    """What is impossible: key and words."""


def impossible(vehicle: Vehicle) -> list[Problem]:
    """Return what keeps a vehicle from being or flying; its numbers are known to have signs and shapes.

    What follows from another problem is not told. Without three torques there is no hover, and a wrong mass
    or place makes the moments look wrong.
    """
    layout = _first_problem((_check_signs, _check_independence), vehicle)
    body = _first_problem((_check_reach, _check_thrust, _check_inertia), vehicle)
    hover = [] if layout or body else _first_problem((_check_hover,), vehicle)
    sizes = [] if body and body[0].key == PLACES else _first_problem((_check_places,), vehicle)
    return [*layout, *body, *hover, *_first_problem((_check_times,), vehicle), *sizes]


def _first_problem(checks: tuple[Callable[[Vehicle], None], ...], vehicle: Vehicle) -> list[Problem]:
    found = (_problem_of(check, vehicle) for check in checks)
    return [problem for problem in found if problem is not None][:1]


def _problem_of(check: Callable[[Vehicle], None], vehicle: Vehicle) -> Problem | None:
    try:
        check(vehicle)
    except _ImpossibleError as error:
        return Problem(*error.args)
    return None


def _refuse(key: str, value: float | NDArray[np.float64], why: str) -> None:
    shown = f"{value:g}" if isinstance(value, float) else str(np.asarray(value).tolist())
    raise _ImpossibleError(key, f"= {shortened(shown)}: {why}")


def _check_signs(vehicle: Vehicle) -> None:
    """Signs are signs, and a reaction torque opposes the spin."""
    rotors = vehicle.rotors
    for name in ("yaw_sign", "spin_sign"):
        signs = getattr(rotors, name)
        if not np.all(np.abs(signs) == 1.0):
            _refuse(f"rotors.{name}", signs, "expected 1 or -1 for each rotor")
    if not np.array_equal(rotors.yaw_sign, -rotors.spin_sign):
        expected = f"expected the opposite of rotors.spin_sign, {(-rotors.spin_sign).tolist()}"
        _refuse("rotors.yaw_sign", rotors.yaw_sign, f"{expected}: the reaction torque opposes the spin")


def _check_independence(vehicle: Vehicle) -> None:
    """Thrust and the three torques can be commanded apart from each other, whatever else is held."""
    rows = vehicle.effectiveness
    sizes = np.linalg.norm(rows, axis=1)
    for index, axis in enumerate(TORQUE_ROWS, start=1):
        key = "yaw_sign" if axis == "yaw" else "positions"
        left = _apart_from_others(rows / np.maximum(sizes, ROUNDING)[:, None], index) if sizes[index] else 0.0
        if left < INDEPENDENCE:
            value, others = (
                getattr(vehicle.rotors, key),
                ("thrust", *TORQUE_ROWS[: index - 1], *TORQUE_ROWS[index:]),
            )
            _refuse(
                f"rotors.{key}",
                value,
                f"this layout cannot give a torque about each axis: {axis} comes only together with "
                f"{', '.join(others[:-1])} or {others[-1]}",
            )


def _apart_from_others(rows: Floats, index: int) -> float:
    """Share of a unit row that the other rows do not span."""
    others, row = np.delete(rows, index, axis=0), rows[index]
    return float(np.linalg.norm(row - row @ np.linalg.pinv(others) @ others))


def _check_reach(vehicle: Vehicle) -> None:
    """The rotors are where a multirotor has them."""
    if (reach := vehicle.reach) > REACH:
        millimetres = f"; {reach:g} mm are {1e-3 * reach:g} m" if 1e-3 * reach <= REACH else ""
        why = f"a rotor {reach:.3g} m from the centre: expected within {REACH:g} m{millimetres}"
        _refuse(PLACES, vehicle.rotors.positions, why)


def _check_thrust(vehicle: Vehicle) -> None:
    """The rotors carry the weight, with room to tilt and to sink."""
    rotors, weight = vehicle.rotors, vehicle.weight
    if rotors.command_idle >= rotors.command_trim:
        why = f"expected less than rotors.command_trim = {rotors.command_trim:g}"
        _refuse("rotors.command_idle", rotors.command_idle, why)
    low, high = THRUST_TO_WEIGHT
    if not low <= vehicle.thrust_to_weight <= high:
        is_grams = low <= 1e3 * vehicle.thrust_to_weight <= high
        grams = f"; {vehicle.mass:g} g are {1e-3 * vehicle.mass:g} kg" if is_grams else ""
        why = (
            f"{weight:.5g} N of weight on {vehicle.thrust_max:.5g} N of thrust "
            f"(rotors.thrust_gain, command_max), thrust to weight {vehicle.thrust_to_weight:.3g}: "
            f"expected within [{low:g}, {high:g}]{grams}"
        )
        _refuse("mass", vehicle.mass, why)
    if (slow := vehicle.thrust_min) > SINK * weight:
        why = f"it carries {slow:.4g} N of {weight:.4g} N of weight: expected at most {SINK:g} of the weight"
        _refuse("rotors.command_min", rotors.command_min, why)


def _check_inertia(vehicle: Vehicle) -> None:
    """The moments are those of a body, of this mass and this size."""
    inertia = vehicle.inertia
    for axis in range(3):
        others = float(np.sum(inertia) - inertia[axis])
        if inertia[axis] > others * (1.0 + ROUNDING):
            why = (
                f"no body has these: {inertia[axis]:g} kg m² is larger than the sum of the others, {others:g}"
            )
            _refuse("inertia", inertia, why)
    reach = vehicle.reach
    least, most = (vehicle.mass * (share * reach) ** 2 for share in GYRATION)
    if not (np.all(inertia >= least) and np.all(inertia <= most)):
        why = (
            f"expected each within [{least:.3g}, {most:.3g}] kg m², for mass = {vehicle.mass:g} kg "
            f"and rotors {reach:.3g} m from the centre"
        )
        _refuse("inertia", inertia, why)
    rotors = vehicle.rotors
    if (moment := len(rotors.positions) * rotors.rotor_inertia) > inertia[2]:
        why = (
            f"the rotors together, {moment:g} kg m², exceed inertia[2] = {inertia[2]:g} kg m², which has them"
        )
        _refuse("rotors.rotor_inertia", rotors.rotor_inertia, why)


def _check_hover(vehicle: Vehicle) -> None:
    """In hover each rotor is within its limits, and leaves torque about each axis."""
    rotors = vehicle.rotors
    least, most = rotors.thrust_range
    inverse = np.linalg.pinv(vehicle.effectiveness)  # (n, 4)
    thrusts = inverse[:, 0] * vehicle.weight
    if np.any(thrusts < least) or np.any(thrusts > most):
        shown = np.array2string(thrusts, precision=3, separator=", ")
        why = f"hover needs the thrusts {shown} N, expected within [{least:.3g}, {most:.3g}] N"
        _refuse("rotors.positions", rotors.positions, why)
    room = np.minimum(thrusts - least, most - thrusts)
    torque = np.min(room[:, None] / np.maximum(np.abs(inverse[:, 1:]), ROUNDING), axis=0)
    for axis, bound in enumerate(AGILITY):
        if (agility := torque[axis] / vehicle.inertia[axis]) < bound:
            key = "yaw_gain" if axis == 2 else "thrust_gain"
            why = (
                f"in hover it leaves {torque[axis]:.3g} N m of {TORQUE_ROWS[axis]} torque, "
                f"{agility:.3g} rad/s² of inertia: expected at least {bound:g} rad/s²"
            )
            _refuse(f"rotors.{key}", getattr(rotors, key), why)


def _check_times(vehicle: Vehicle) -> None:
    """Drag stops nothing at once."""
    rotors, drag = vehicle.rotors, vehicle.rotational_drag
    if np.any(drag * ROTATION_DECAY > vehicle.inertia):
        time = float(np.min(vehicle.inertia / np.maximum(drag, ROUNDING * vehicle.inertia)))
        why = f"a free rotation would die within {time:.3g} s, expected {ROTATION_DECAY:g} s at least"
        _refuse("rotational_drag", drag, why)
    linear = len(rotors.positions) * vehicle.aerodynamics.rotor_drag * vehicle.hover_speed
    if linear * DRIFT_DECAY > vehicle.mass:
        stop = vehicle.mass / linear
        why = f"it would stop the vehicle within {stop:.3g} s, expected {DRIFT_DECAY:g} s at least"
        _refuse("aerodynamics.rotor_drag", vehicle.aerodynamics.rotor_drag, why)


def _check_places(vehicle: Vehicle) -> None:
    """Lever arms and areas fit the size of the vehicle."""
    rotors, air, reach = vehicle.rotors, vehicle.aerodynamics, vehicle.reach
    if rotors.torque_to_thrust > reach:
        why = (
            f"yaw_gain / thrust_gain = {rotors.torque_to_thrust:.3g} m, expected less than the {reach:.3g} m"
        )
        _refuse("rotors.yaw_gain", rotors.yaw_gain, f"{why} from the centre to the rotors")
    if np.any(air.drag_area > (largest := (4.0 * reach) ** 2)):
        why = f"expected at most {largest:.3g} m², a square of twice the span of the rotors"
        _refuse("aerodynamics.drag_area", air.drag_area, why)
    if np.linalg.norm(air.imu_position) > 2.0 * reach:
        why = f"expected at most {2.0 * reach:.3g} m from the centre, twice as far as the rotors"
        _refuse("aerodynamics.imu_position", air.imu_position, why)
