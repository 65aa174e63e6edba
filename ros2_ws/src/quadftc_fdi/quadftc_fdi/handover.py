"""A law on a stream of samples that resumes where another one has died: at its first samples, once.

A node that was started in a flight finds words that the controller kept for it, a little older than its first
sample (`quadftc_control.last_words`).
"""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from quadftc_model.stepper import MAX_GAP, In, Out, Stepper, seconds

LONGEST = 10.0  # s; how old the last words may be at the first sample: a fault may have ended since

Words = TypeVar("Words")


class ResumingStepper(Stepper[In, Out], Generic[In, Out, Words]):
    """A stepper that uses last words once, and only if it began after they were said."""

    resumed = 0  # how often it resumed where another one had died
    _first_ns = _newest_ns = _words_ns = 0
    _words: Words | None = None
    _used = False

    def restart(self) -> None:
        """Start at the next sample, without state and last words."""
        self.reset()
        self._first_ns, self._words = 0, None

    def offer(self, stamp_ns: int, words: Words) -> None:
        """Offer the last words [stamp in ns] of a law that has died, to resume from if it has."""
        self._words_ns, self._words = stamp_ns, words

    def words_for(self, stamp_ns: int) -> Words | None:
        """Note a sample [ns]; return the words to resume from at it: `take_over` or `drop_words`, then.

        After a gap over which no state is carried, a sample is the first again.
        """
        if not self._first_ns or abs(seconds(stamp_ns - self._newest_ns)) > MAX_GAP:
            self._first_ns, self._used = stamp_ns, False
        self._newest_ns = stamp_ns
        age = seconds(self._first_ns - self._words_ns)
        return self._words if not self._used and 0.0 < age <= LONGEST else None

    def drop_words(self) -> None:
        """Ignore the words, and later ones of the same loss."""
        self._words, self._used = None, True

    def take_over(self, stamp_ns: int, inputs: In, state: Any) -> Out:
        """Go on at a sample [ns] from the state that the words gave."""
        self.drop_words()
        self.resumed += 1
        return self.resume(stamp_ns, inputs, state)
