# pyright: basic
"""What fault diagnosis asks of a model: which signals are known, which are not, where each fault comes in.

The equations of a vehicle are in :mod:`quadftc_theory.vehicle_equations`, the analysis is in
:mod:`quadftc_theory.isolability`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

COEFFICIENT_ZERO = 1e-12  # 1; a coefficient below it, among values of order 1, is rounding

ANGLES, RATES, VELOCITY, FORCE = (
    ("phi", "theta", "psi"),
    ("p", "q", "r"),
    ("v_x", "v_y", "v_z"),
    ("f_x", "f_y", "f_z"),
)
EULER, BODY = ("roll", "pitch", "yaw"), ("x", "y", "z")

#: Sensors by name: the label of each axis, and the unknown that it measures.
SENSORS: Mapping[str, Mapping[str, str]] = {
    "attitude": dict(zip(EULER, ANGLES, strict=True)),
    "gyro": dict(zip(EULER, RATES, strict=True)),
    "accelerometer": dict(zip(BODY, FORCE, strict=True)),
    "second_attitude": dict(zip(EULER, ANGLES, strict=True)),
    "second_gyro": dict(zip(EULER, RATES, strict=True)),
    "heading": {"yaw": "psi"},
    "velocity": dict(zip(BODY, VELOCITY, strict=True)),
}

_CHOICES = {
    "motion": ("hover", "turn"),
    "actuators": ("axes", "rotors", "unknown"),
    "disturbances": ("faults", "unknown_inputs", "absent"),
    "air": ("still", "wind", "no_drag"),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Assumptions:
    """What is measured, what is known and what disturbs.

    Parameters
    ----------
    sensor_set : sequence of str
        Names out of `SENSORS`; kept in the order of that table.
    motion : str
        ``hover``: terms of second order vanish, the axes are decoupled. ``turn``: a steady banked turn, in
        which attitude, rates and velocity are coupled.
    actuators : str
        ``axes``: the torque about each axis is commanded, and each can fail; the thrust is not known.
        ``rotors``: the command of each rotor is known, and each can fail. ``unknown``: torques are not known.
    disturbances : str
        Torques about the body axes: ``faults`` to be told apart from all others, ``unknown_inputs`` that
        every residual has to be blind to, or ``absent``.
    air : str
        ``still``: linear drag in still air. ``wind``: linear drag in an unknown wind on each axis.
        ``no_drag``: the thrust is the only force besides the weight.

    Raises
    ------
    ValueError
        If a name is unknown or given twice, or no sensor is given.
    """

    sensor_set: Sequence[str] = ("attitude", "gyro")
    motion: str = "hover"
    actuators: str = "axes"
    disturbances: str = "faults"
    air: str = "still"

    def __post_init__(self) -> None:
        """Check the names."""
        given = [self.sensor_set] if isinstance(self.sensor_set, str) else list(self.sensor_set)
        for name in given:
            if name not in SENSORS:
                raise ValueError(f"sensor_set: '{name}' is none of {', '.join(SENSORS)}")
        if not given or len(set(given)) < len(given):
            raise ValueError(f"sensor_set = {given}: expected at least one sensor, each once")
        object.__setattr__(self, "sensor_set", tuple(name for name in SENSORS if name in given))
        for field, choices in _CHOICES.items():
            if getattr(self, field) not in choices:
                raise ValueError(f"{field} = {getattr(self, field)!r}: expected one of {', '.join(choices)}")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class LinearModel:
    """Equations 0 = E x' + A x + B w + F f + K z, linear around one motion, and with that their structure.

    The states x are the unknowns of which derivatives appear, w the other unknowns, f the faults and z the
    known signals. A fault must be in exactly one equation, as the structural analysis asks.

    Raises
    ------
    ValueError
        If a fault is in no equation, or in several.
    """

    name: str
    states: tuple[str, ...]
    unknowns: tuple[str, ...]
    faults: tuple[str, ...]
    known: tuple[str, ...]
    E: NDArray[np.float64]  # (equations, states)
    A: NDArray[np.float64]  # (equations, states)
    B: NDArray[np.float64]  # (equations, unknowns)
    F: NDArray[np.float64]  # (equations, faults)
    K: NDArray[np.float64]  # (equations, known)

    def __post_init__(self) -> None:
        """Check the faults."""
        for fault, count in zip(self.faults, np.count_nonzero(self.F, axis=0), strict=True):
            if count != 1:
                raise ValueError(f"{self.name}: fault '{fault}' is in {count} equations, expected 1")


def linearised(
    name: str,
    equations: Sequence[Any],
    *,
    states: Sequence[str],
    unknowns: Sequence[str],
    faults: Sequence[str],
    known: Sequence[str],
    point: Mapping[str, float],
) -> LinearModel:
    """Linear model of symbolic equations around a point.

    Parameters
    ----------
    name : str
        What the model is of.
    equations : sequence of sympy.Expr
        Each is zero in the absence of faults; the derivative of state ``x`` is the symbol ``dx``.
    states, unknowns, faults, known : sequence of str
        Names of the symbols.
    point : mapping of str to float
        Values of all symbols that are left in the derivatives of the equations.
    """
    import sympy

    values = {sympy.Symbol(symbol): value for symbol, value in point.items()}

    def coefficients(names: Sequence[str]) -> NDArray[np.float64]:
        if not names:
            return np.zeros((len(equations), 0))
        jacobian = sympy.Matrix(list(equations)).jacobian([sympy.Symbol(symbol) for symbol in names])
        dense = np.array(jacobian.subs(values).tolist(), dtype=np.float64)
        return np.where(np.abs(dense) < COEFFICIENT_ZERO, 0.0, dense)

    return LinearModel(
        name=name,
        states=tuple(states),
        unknowns=tuple(unknowns),
        faults=tuple(faults),
        known=tuple(known),
        E=coefficients([f"d{state}" for state in states]),
        A=coefficients(states),
        B=coefficients(unknowns),
        F=coefficients(faults),
        K=coefficients(known),
    )
