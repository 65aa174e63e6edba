"""What a vehicle can still do with a rotor that is weak or off: the attainable set, and steady turning.

Yaw is held in hover as long as weak rotors leave torque both ways. Source: Du, Quan, Yang and Cai (2015),
Controllability analysis for multirotor helicopter rotor degradation and failure, J. Guidance, Control, and
Dynamics 38(5). Beyond it the vehicle spins; about body z, it has no torque about x and y in the mean.

A quadrotor lifts more when it turns about a tilted axis. Its thrusts F and its body rate omega are steady
(Mueller and D'Andrea (2014)) where

    omega x (J omega + h e3) + k_d omega = M(F)

and a share omega_z / |omega| of the thrust lifts. Here the two rotors beside the lost one are at their
limit, and of the thrusts of the one opposite that is taken which lifts most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import fsolve

from quadftc_control.reduced_attitude import ReducedAttitude, yaw_left
from quadftc_model.vehicle import Vehicle
from quadftc_model.wrench_set import extremes, limits
from quadftc_theory.conditions import Condition, Floats, Verdict, assess

SHARES = np.linspace(0.0, 1.0, 101)  # 1; of a rotor's effectiveness, and of the opposite rotor's thrust


def rotor_conditions(vehicle: Vehicle, lost: Sequence[int] = ()) -> Iterator[Condition]:
    """Judge the loss of each single rotor; that of those ``lost`` (0, 1, ...) is needed."""
    count = len(vehicle.rotors.positions)
    margin = ReducedAttitude().enter
    losses = [largest_loss(vehicle, rotor, margin) for rotor in range(count)]
    text = f"each rotor may lose {_percent(losses)} % of its thrust before less than {100 * margin:.0f} % "
    text += "of yaw's torque is left in hover, and the vehicle spins"
    yield assess("yaw held with a weak rotor", min(losses) > 0.0, text, needed=False, largest_loss=losses)
    for rotor in range(count):
        yield _without(vehicle, rotor, margin, rotor in lost)


def _without(vehicle: Vehicle, rotor: int, margin: float, needed: bool) -> Condition:
    """Judge hover without a rotor."""
    count, name = len(vehicle.rotors.positions), f"rotor {rotor + 1} off"
    effectiveness = np.where(np.arange(count) == rotor, 0.0, 1.0)
    if float(yaw_left(vehicle, effectiveness)) > margin:
        lift = _highest(vehicle, effectiveness, held=True)
        return assess(name, True, f"hovers without a spin; lifts {lift:.3g} times its weight", lift=lift)
    upright = lift = _highest(vehicle, effectiveness, held=False)
    text = f"spins; lifts {upright:.3g} times its weight about body z"
    if count == 4:
        lift, rate = steady_lift(vehicle, rotor)
        text += f", {lift:.3g} times at most about a tilted axis, at {rate:.3g} rad/s"
    if lift <= 1.0:
        text += ": it comes down, however it is controlled"
        return Condition(name, Verdict.FAIL, text, {"lift": lift, "upright": upright}, needed)
    if upright <= 1.0:
        text += "; the control here holds body z, and comes down"
    return assess(name, upright > 1.0, text, Verdict.DEPENDS, needed, lift=lift, upright=upright)


def largest_loss(vehicle: Vehicle, rotor: int, margin: float) -> float:
    """Largest loss of one rotor [1] that leaves a share ``margin`` of the yaw torque in hover."""
    one = np.arange(len(vehicle.rotors.positions)) == rotor
    left = yaw_left(vehicle, np.where(one, 1.0 - SHARES[:, None], 1.0))
    enough = np.flatnonzero(np.cumsum(left < margin) == 0)
    return float(SHARES[enough[-1]]) if len(enough) else 0.0


def steady_lift(vehicle: Vehicle, lost: int) -> tuple[float, float]:
    """Largest lift over the weight [1] of a quadrotor that turns steadily, and its body rate [rad/s]."""
    rotors = vehicle.rotors
    most = rotors.thrust_coefficient * rotors.speed_max**2
    places = rotors.positions
    opposite = int(np.argmin(places @ places[lost]))
    found, rate = [(0.0, 0.0)], None
    for share in SHARES:
        thrusts = np.full(4, most)
        thrusts[[lost, opposite]] = 0.0, share * most
        rate = _steady_rate(vehicle, thrusts, rate)
        if rate is not None:
            size = float(np.linalg.norm(rate))
            found.append((float(np.sum(thrusts) * abs(rate[2]) / size / vehicle.weight), size))
    return max(found)


def _steady_rate(vehicle: Vehicle, thrusts: Floats, start: Floats | None) -> Floats | None:
    """Body rate [rad/s] that stays as it is under thrusts [N]; None where none is found."""
    rotors, inertia = vehicle.rotors, vehicle.inertia
    torque = (vehicle.effectiveness @ thrusts)[1:]
    speeds = np.sqrt(thrusts / rotors.thrust_coefficient)
    spun = np.array([0.0, 0.0, rotors.rotor_inertia * float(rotors.spin_sign @ speeds)])

    def change(rate: Floats) -> Floats:
        return (torque - np.cross(rate, inertia * rate + spun) - vehicle.rotational_drag * rate) / inertia

    if start is None:
        start = np.array([0.0, 0.0, torque[2] / vehicle.rotational_drag[2]])
    rate, _, status, _ = fsolve(change, start, full_output=True)
    return rate if status == 1 else None


def _highest(vehicle: Vehicle, effectiveness: Floats, held: bool) -> float:
    """Largest thrust over the weight without roll and pitch torque; ``held``: without yaw torque, too."""
    whole, bounds = vehicle.wrench_set, limits(vehicle, effectiveness)
    over = whole.thrust_held if held else whole.thrust
    return float(extremes(over, bounds, np.zeros(3 if held else 2))[1]) / vehicle.weight


def _percent(shares: Sequence[float]) -> str:
    """Return the least and the largest share in percent, one number if they are alike."""
    low, high = (f"{100.0 * share:.0f}" for share in (min(shares), max(shares)))
    return low if low == high else f"{low} to {high}"
