"""Scales of figures: whether logarithmic, from where to where, and what is written at them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_report.wording import plain

Floats = NDArray[np.float64]

RATIO = 8.0  # between the largest and the smallest, from which on a scale is logarithmic
BEYOND_ZERO = 2.0  # ratio of the smallest value that is not zero to the lower end, where zero is drawn
MARGIN = 0.04  # of the length of a scale, on both ends
DECADES = 3.5  # longest logarithmic scale on which 2 and 5 are written, too


class Scale(NamedTuple):
    """A scale of values."""

    low: float
    high: float
    log: bool
    zeros: bool = False  # logarithmic; what is zero is drawn at the lower end

    @property
    def ticks(self) -> list[float]:
        """Where numbers stand on a logarithmic scale."""
        if self.zeros:
            return [self.low, *(value for value in self._between if value > BEYOND_ZERO * self.low)]
        return self._between

    @property
    def _between(self) -> list[float]:
        first, last = math.log10(self.low), math.log10(self.high)
        steps = (1.0, 2.0, 5.0) if last - first <= DECADES else (1.0,)
        found = [
            step * 10.0**power
            for power in range(math.floor(first), math.floor(last) + 1)
            for step in steps
            if first <= math.log10(step * 10.0**power) <= last
        ]
        return found or [self.low, self.high]

    @property
    def tick_texts(self) -> list[str]:
        """What stands there."""
        texts = [plain(value) for value in self.ticks]
        return ["0", *texts[1:]] if self.zeros else texts


def scale_of(parts: Iterable[Floats]) -> Scale:
    """Return a scale on which all values fit; zeros of a logarithmic one are at its lower end.

    Parameters
    ----------
    parts : iterable of arrays
        Not negative, finite.
    """
    values = np.concatenate([*parts, np.empty(0)])
    positive = values[values > 0.0]
    if not len(positive):
        return Scale(0.0, 1.0, False)
    low, high = float(positive.min()), float(positive.max())
    zeros = len(positive) < len(values)
    if high < RATIO * low:
        room = MARGIN * (high - low) or 0.5 * high
        return Scale(0.0 if zeros else max(low - room, 0.0), high + room, False)
    room = (high / low) ** MARGIN
    return Scale(low / (BEYOND_ZERO if zeros else room), high * room, True, zeros)
