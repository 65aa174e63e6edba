"""When an observer takes over from one that has died: at its first samples, from words that are not old.

A node cannot know whether it was started for a flight or in one. But what the controller keeps for it
(`quadftc_control.keeper`) tells: it is older than the node's own first sample, and not by much.
"""

from __future__ import annotations

from quadftc_model.stepper import MAX_GAP, seconds

LONGEST = 10.0  # s; how old the last words may be at the first sample: a fault may have ended since


class Handover:
    """Decides when last words are used: once, and only by an observer that began after they were said."""

    def __init__(self) -> None:
        self._first_ns = self._newest_ns = self._words_ns = 0
        self._waiting = self._done = False

    def heard(self, stamp_ns: int) -> None:
        """Note that last words have come, of a stamp [ns]."""
        self._words_ns, self._waiting = stamp_ns, True

    def sampled(self, stamp_ns: int) -> None:
        """Note a sample [ns]; after a gap over which nothing can be carried it is the first again."""
        if not self._first_ns or abs(seconds(stamp_ns - self._newest_ns)) > MAX_GAP:
            self._first_ns, self._done = stamp_ns, False
        self._newest_ns = stamp_ns

    def forget(self) -> None:
        """Begin anew, without last words."""
        self._first_ns, self._waiting = 0, False

    def due(self) -> bool:
        """Whether to use the last words at the sample noted; afterwards, call `forget_words`."""
        begun_later = 0.0 < seconds(self._first_ns - self._words_ns) <= LONGEST
        return self._waiting and not self._done and begun_later

    def forget_words(self) -> None:
        """They were used: what comes of the same loss later is not."""
        self._waiting, self._done = False, True
