"""Numbers as people read them: three digits, a unit, no exponent; lists of axes and of things."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from quadftc_model.samples import AXES

NO_VALUE = "no value"
DIGITS = 3  # significant
SMALLEST = 1e-4  # in any unit; what is smaller is said to be below it
ALIKE = 2.0  # axes whose values differ by less than this factor are told as a range

PerAxis = Mapping[str, float | None]


def plain(value: float) -> str:
    """Write a number with three significant digits and no exponent: 0.00123, -1.5, 1230."""
    text = np.format_float_positional(float(value), precision=DIGITS, fractional=False, trim="-")
    return "0" if text in ("-0", "0") else text


def short(value: float) -> str:
    """Write a number as `plain` does, and what is too small to matter as ``below 0.0001``."""
    return f"below {SMALLEST}" if 0.0 < abs(value) < SMALLEST else plain(value)


def quantity(value: float | None, unit: str) -> str:
    """Write a number with its unit; None is no value."""
    return NO_VALUE if value is None else f"{short(value)} {unit}".rstrip()


def duration(value: float | None) -> str:
    """Write a time [s]; below a second in ms."""
    if value is None:
        return NO_VALUE
    return f"{plain(1e3 * value)} ms" if 0.0 < abs(value) < 1.0 else f"{plain(value)} s"


def period(start: float, stop: float) -> str:
    """Write a stretch of time [s]."""
    return f"from {plain(start)} s on" if math.isinf(stop) else f"from {plain(start)} to {plain(stop)} s"


def listing(items: Sequence[str], last: str = "and") -> str:
    """Write a list: ``a``, ``a and b``, ``a, b and c``."""
    *first, end = items or [""]
    return f"{', '.join(first)} {last} {end}" if first else end


def counted(number: int, thing: str) -> str:
    """Write how many of a thing: ``1 run``, ``2 runs``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def known(values: PerAxis) -> dict[str, float]:
    """Return the axes that have a value."""
    return {axis: value for axis, value in values.items() if value is not None}


def each_axis(values: PerAxis, unit: str) -> str:
    """Write the value of every axis: ``1.1 (roll), 2 (pitch), 3 deg (yaw)``."""
    there = known(values)
    if not there:
        return NO_VALUE
    *first, (axis, value) = there.items()
    parts = [f"{short(number)} ({name})" for name, number in first]
    return ", ".join([*parts, f"{quantity(value, unit)} ({axis})"])


def spread(values: PerAxis, unit: str) -> str:
    """Write sizes as a range where they are alike, ``1.1 (roll) to 1.4 deg (yaw)``, else axis by axis."""
    there = known(values)
    ordered = sorted(there.items(), key=lambda item: item[1])
    if len(ordered) > 1 and len({plain(size) for size in there.values()}) == 1:
        return quantity(ordered[0][1], unit)
    if len(ordered) < 3 or ordered[0][1] < SMALLEST or ordered[-1][1] > ALIKE * ordered[0][1]:
        return each_axis(there, unit)
    (low_axis, low), (high_axis, high) = ordered[0], ordered[-1]
    return f"{plain(low)} ({low_axis}) to {quantity(high, unit)} ({high_axis})"


def worst(values: PerAxis) -> tuple[str, float] | None:
    """Return the axis with the largest size, and its value."""
    there = known(values)
    return max(there.items(), key=lambda item: abs(item[1])) if there else None


def worst_text(values: PerAxis, unit: str) -> str:
    """Write the largest size with its axis: ``0.0085 deg (yaw)``."""
    found = worst(values)
    return NO_VALUE if found is None else f"{quantity(abs(found[1]), unit)} ({found[0]})"


def axes_text(axes: Sequence[str]) -> str:
    """Write which axes: ``on roll and yaw``, ``on every axis``."""
    return "on every axis" if len(axes) == len(AXES) else f"on {listing(axes)}"


def sentence(*parts: str) -> str:
    """Join what is not empty into a sentence with a capital and a full stop."""
    text = " ".join(part for part in parts if part)
    return f"{text[0].upper()}{text[1:]}." if text else ""
