"""Quantities with units, as people write them in files and commands: ``1 deg``, ``0.05 N m``.

A bare number is SI. The code works in SI throughout; here alone are other units turned into it.
"""

from __future__ import annotations

import math
import re

_DEG = math.pi / 180.0

# SI unit -> spellings (without spaces) of it and of its relatives, each with the factor to SI
_SPELLINGS: dict[str, dict[str, float]] = {
    "rad": {"rad": 1.0, "deg": _DEG, "mrad": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": _DEG},
    "rad/s^2": {"rad/s^2": 1.0, "rad/s²": 1.0, "deg/s^2": _DEG, "deg/s²": _DEG},
    "rad/sqrt(s)": {"rad/sqrt(s)": 1, "rad/s/sqrt(Hz)": 1, "deg/s/sqrt(Hz)": _DEG, "deg/sqrt(h)": _DEG / 60},
    "rad/s/sqrt(s)": {"rad/s/sqrt(s)": 1.0, "deg/s/sqrt(s)": _DEG},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "1/s": {"1/s": 1.0, "Hz": 1.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "N m": {"Nm": 1.0, "mNm": 1e-3},
    "m/s^2": {"m/s^2": 1.0, "m/s²": 1.0, "g": 9.80665},
    "m/s^3": {"m/s^3": 1.0, "m/s³": 1.0},
    "1": {"": 1.0, "%": 1e-2},
}

_QUANTITY = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?inf)\s*(.*?)\s*$")


def quantity(value: object, unit: str) -> float:
    """Return a number (SI already), or a text such as ``"1 deg"``, ``"20ms"``, ``"3"``, in the SI ``unit``.

    A unit that is not in this module's table takes numbers and its own name only.
    """
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        number, spelling = float(value), ""
    else:
        match = _QUANTITY.match(value) if isinstance(value, str) else None
        if match is None:
            raise ValueError(f"{value!r}: expected a number{'' if unit == '1' else f' in {unit}'}")
        number, spelling = float(match[1]), match[2].replace(" ", "")
    if math.isnan(number):
        raise ValueError(f"{value!r}: expected a number in {unit}, not NaN")
    if spelling == "":
        return number
    spellings = _SPELLINGS.get(unit, {unit.replace(" ", ""): 1.0})
    factor = spellings.get(spelling)
    if factor is None:
        wanted = ", ".join(name for name in spellings if name) or "a bare number"
        raise ValueError(f"{value!r}: '{spelling}' is not a unit of this quantity; expected {wanted}")
    return number * factor
