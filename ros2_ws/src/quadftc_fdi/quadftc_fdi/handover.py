"""When an observer resumes where another one has died: at its first samples, from words that are not old.

A node cannot know whether it was started for a flight or in one. The words that the controller keeps for it
(`quadftc_control.keeper`) tell: they are older than the node's first sample, and not by much.
"""

from __future__ import annotations

from typing import Generic, TypeVar

from quadftc_model.stepper import MAX_GAP, seconds

LONGEST = 10.0  # s; how old the last words may be at the first sample: a fault may have ended since

Words = TypeVar("Words")


class Handover(Generic[Words]):
    """Decides when last words are used: once, and only by an observer that began after they were said."""

    def __init__(self) -> None:
        self._first_ns = self._newest_ns = self._words_ns = 0
        self._words: Words | None = None
        self._used = False

    def offer(self, stamp_ns: int, words: Words) -> None:
        """Offer last words of a stamp [ns]."""
        self._words_ns, self._words = stamp_ns, words

    def words_for(self, stamp_ns: int) -> Words | None:
        """Note a sample [ns]; return the words to resume from at it. When they were used, call `close`.

        After a gap over which no state is carried, a sample is the first again.
        """
        if not self._first_ns or abs(seconds(stamp_ns - self._newest_ns)) > MAX_GAP:
            self._first_ns, self._used = stamp_ns, False
        self._newest_ns = stamp_ns
        age = seconds(self._first_ns - self._words_ns)
        return self._words if not self._used and 0.0 < age <= LONGEST else None

    def close(self) -> None:
        """Note that the words were used; later words of the same loss are ignored."""
        self._words, self._used = None, True

    def restart(self) -> None:
        """Forget samples and words."""
        self._first_ns, self._words = 0, None
