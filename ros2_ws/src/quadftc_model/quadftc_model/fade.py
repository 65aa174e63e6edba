"""Going over from one law to another without a jump.

At the change, what the two laws give at the same sample differs by an offset. It is added to what the new
one gives, and given up in a straight line over `FADE`.
"""

from __future__ import annotations

from quadftc_model.arrays import Components
from quadftc_model.stepper import seconds

FADE = 1.0  # s; in which an offset is given up


class Fade:
    """An offset of one vehicle; none before `begin` and once `FADE` is over."""

    def __init__(self) -> None:
        self._offset: Components | None = None
        self._since_ns = 0

    def begin(self, stamp_ns: int, offset: Components) -> None:
        """Begin at a sample [ns] with an offset (n,)."""
        self._offset, self._since_ns = offset, stamp_ns

    def at(self, stamp_ns: int) -> Components | None:
        """Return what is left of the offset at a sample [ns]; None: nothing."""
        if self._offset is None:
            return None
        left = 1.0 - seconds(stamp_ns - self._since_ns) / FADE
        if not 0.0 < left <= 1.0:
            self._offset = None
            return None
        return left * self._offset
