"""Numbers as people read them: three digits, a unit, no exponent."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

import numpy as np

from quadftc_model.samples import AXES

NOTHING = "–"  # in place of a number that is missing
DIGITS = 3  # significant
SMALLEST = 1e-4  # in any unit; a smaller number is written as "below" this


def plain(value: float) -> str:
    """Write a number with three significant digits and no exponent: 0.00123, -1.5, 1230."""
    text = np.format_float_positional(float(value), precision=DIGITS, fractional=False, trim="-")
    return "0" if text in ("-0", "0") else text


def short(value: float | None, scale: float = 1.0) -> str:
    """Write a number times ``scale`` as `plain` does, a tiny one as ``below 0.0001``; None is a dash."""
    if value is None:
        return NOTHING
    value *= scale
    return f"below {SMALLEST}" if 0.0 < abs(value) < SMALLEST else plain(value)


def unbroken(text: str) -> str:
    """Keep each number on one line with its unit."""
    return re.sub(r"(?<=\d) (?=(?:s|%|V|Hz|mG|deg|rad/s|m/s²|m/s|m)(?:[ ,;.)]|$))", "\u00a0", text)


def duration(value: float) -> str:
    """Write a time [s]; below a second in ms."""
    return f"{plain(1e3 * value)} ms" if 0.0 < abs(value) < 1.0 else f"{plain(value)} s"


def period(start: float, stop: float) -> str:
    """Write a stretch of time [s]: ``2 to 3 s``, ``2 s on``."""
    return f"{plain(start)} s on" if math.isinf(stop) else f"{plain(start)} to {plain(stop)} s"


def listing(items: Sequence[str]) -> str:
    """Write a list: ``a``, ``a and b``, ``a, b and c``."""
    *first, end = items or [""]
    return f"{', '.join(first)} and {end}" if first else end


def counted(number: int, thing: str) -> str:
    """Write how many of a thing: ``1 run``, ``2 runs``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def each_axis(values: Iterable[float | None], unit: str) -> str:
    """Write a number of every axis: ``roll 1, pitch 2, yaw 3 deg``."""
    return f"{', '.join(f'{axis} {short(value)}' for axis, value in zip(AXES, values, strict=True))} {unit}"
