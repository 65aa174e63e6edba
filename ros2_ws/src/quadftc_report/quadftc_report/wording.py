"""Numbers as people read them: three digits, a unit, no exponent; lists of axes and of things."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

NO_VALUE = "no value"
NOTHING = "–"  # in a table, in place of a number that is missing
DIGITS = 3  # significant
SMALLEST = 1e-4  # in any unit; a smaller number is written as "below" this
ALIKE = 2.0  # axes whose values differ by less than this factor are written as a range

PerAxis = Mapping[str, float | None]


def plain(value: float) -> str:
    """Write a number with three significant digits and no exponent: 0.00123, -1.5, 1230."""
    text = np.format_float_positional(float(value), precision=DIGITS, fractional=False, trim="-")
    return "0" if text in ("-0", "0") else text


def short(value: float | None) -> str:
    """Write a number as `plain` does, a tiny one as ``below 0.0001``; None is a dash."""
    if value is None:
        return NOTHING
    return f"below {SMALLEST}" if 0.0 < abs(value) < SMALLEST else plain(value)


def quantity(value: float | None, unit: str) -> str:
    """Write a number with its unit."""
    return NO_VALUE if value is None else f"{short(value)} {unit}".rstrip()


def duration(value: float) -> str:
    """Write a time [s]; below a second in ms."""
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


def each_axis(values: PerAxis, unit: str) -> str:
    """Write the value of every axis: ``1.1 (roll), 2 (pitch), 3 deg (yaw)``."""
    known = [(axis, value) for axis, value in values.items() if value is not None]
    if not known:
        return NO_VALUE
    *first, (axis, value) = known
    return ", ".join(
        [*(f"{short(each)} ({name})" for name, each in first), f"{quantity(value, unit)} ({axis})"]
    )


def spread(values: PerAxis, unit: str) -> str:
    """Write sizes as a range where they are alike, ``1.1 (roll) to 1.4 deg (yaw)``, else axis by axis."""
    ordered = sorted((value, axis) for axis, value in values.items() if value is not None)
    if len(ordered) > 1 and len({plain(size) for size, _ in ordered}) == 1:
        return quantity(ordered[0][0], unit)
    if len(ordered) < 3 or ordered[0][0] < SMALLEST or ordered[-1][0] > ALIKE * ordered[0][0]:
        return each_axis(values, unit)
    (low, low_axis), (high, high_axis) = ordered[0], ordered[-1]
    return f"{plain(low)} ({low_axis}) to {quantity(high, unit)} ({high_axis})"


def worst_text(values: PerAxis, unit: str) -> str:
    """Write the largest size with its axis: ``0.0085 deg (yaw)``."""
    sizes = [(abs(value), axis) for axis, value in values.items() if value is not None]
    if not sizes:
        return NO_VALUE
    size, axis = max(sizes, key=lambda item: item[0])
    return f"{quantity(size, unit)} ({axis})"


def sentence(*parts: str) -> str:
    """Join non-empty parts into a sentence with a capital and a full stop."""
    text = " ".join(part for part in parts if part)
    return f"{text[0].upper()}{text[1:]}." if text else ""
