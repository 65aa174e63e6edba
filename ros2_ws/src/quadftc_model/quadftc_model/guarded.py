"""A law that never stops the vehicle: in place of what cannot be used it says a fallback, and restarts."""

from __future__ import annotations

import dataclasses
import sys
from typing import Any, Generic, Protocol, TypeVar, cast

from quadftc_model.arrays import Flag, Scalar, branch, finite, where
from quadftc_model.stepper import MAX_GAP, In_contra, Law, Stepper, seconds

if sys.version_info >= (3, 11):
    from typing import NamedTuple
else:
    from typing_extensions import NamedTuple  # that of Python 3.10 cannot be generic

In = TypeVar("In")
Out = TypeVar("Out")
Words = TypeVar("Words")

OLDEST_WORDS = 10.0  # s; at the first sample: a fault may have ended since


class RestartingLaw(Law[In_contra, Out], Protocol[In_contra, Out]):
    """A law that can be guarded."""

    def ready(self, inputs: In_contra) -> Flag:
        """Whether the law can start at a sample (...)."""
        ...

    def usable(self, output: Out) -> Flag:
        """Whether an output can be used (...)."""
        ...

    def fallback(self, inputs: In_contra, output: Out) -> Out:
        """Return what is said in place of an output, shaped as it."""
        ...


class GuardedState(NamedTuple):
    """State of a law, and whether it is one to go on from."""

    law: object
    starts: Flag  # it is not: the law starts at the next sample at which it can


class GuardedOutput(NamedTuple, Generic[Out]):
    """What a law says, or what is said in its place."""

    said: Out
    failed: Flag  # the law gave what cannot be used, or its state is not finite
    starts: Flag  # the law starts at the next sample at which it can


@dataclasses.dataclass(frozen=True, eq=False)
class Guarded(Generic[In, Out]):
    """A law with a fallback.

    Where an output cannot be used, or a state is not finite, the fallback is said instead, and the law starts
    at the next sample. While a law cannot start, the fallback is said, too.
    """

    law: RestartingLaw[In, Out]

    @property
    def named_after(self) -> object:
        """What it is called after where it is compiled."""
        return self.law

    def example(self) -> In:
        """Return inputs of the law as they will come, for the compiler."""
        law: Any = self.law
        return law.example()

    def example_words(self) -> object:
        """Return last words of the law as they may come, for the compiler; None: it does not resume."""
        return getattr(self.law, "example_words", lambda: None)()

    def init(self, inputs: In) -> GuardedState:
        """Return the state at the first sample."""
        return GuardedState(self.law.init(inputs), ~self.law.ready(inputs))

    def resumed(self, inputs: In, words: object) -> GuardedState:
        """Return the state that resumes at a sample by last words."""
        law: Any = self.law
        state, ready = law.resumed(inputs, words), self.law.ready(inputs)
        return GuardedState(state, ready & ~ready)

    def step(self, state: GuardedState, inputs: In, dt: Scalar) -> tuple[GuardedState, GuardedOutput[Out]]:
        """Advance by ``dt`` [s] to a sample."""
        before = branch(state.starts, lambda: self.law.init(inputs), lambda: state.law)
        after, output = self.law.step(before, inputs, where(state.starts, 0.0, dt))
        waits = state.starts & ~self.law.ready(inputs)
        failed = ~(waits | (self.law.usable(output) & finite(after, waits.ndim)))
        starts = waits | failed
        said = branch(starts, lambda: self.law.fallback(inputs, output), lambda: output)
        return GuardedState(after, starts), GuardedOutput(said, failed, starts)


class GuardedStepper(Stepper[In, Out]):
    """A guarded law on a stream; its ``law`` is the one that is guarded."""

    replaced = 0  # outputs so far that could not be used
    starts = True  # the law starts at the next sample at which it can

    @property
    def state(self) -> Any:
        """State of the law at the last sample; None where it starts at the next."""
        return None if self.starts or self._state is None else self._runner.tree(self._state).law

    def reset(self) -> None:
        """Forget the state; the next sample is the first."""
        super().reset()
        self.starts = True

    def _run_law(self, law: Any) -> object:
        return Guarded(law)

    def _keep(self, stamp_ns: int, stepped: tuple[object, Any]) -> Out:
        output = cast("GuardedOutput[Out]", super()._keep(stamp_ns, stepped))
        self.starts = bool(output.starts)
        self.replaced += bool(output.failed)
        return output.said


class ResumingStepper(GuardedStepper[In, Out], Generic[In, Out, Words]):
    """A law that resumes where another one has died: at its first samples, once.

    A node that was started in a flight finds last words that others have kept, a little older than its first
    sample.
    """

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
        return self._words if not self._used and 0.0 < age <= OLDEST_WORDS else None

    def drop_words(self) -> None:
        """Ignore the words, and later ones of the same loss."""
        self._words, self._used = None, True

    def take_over(self, stamp_ns: int, inputs: In, words: Words) -> Out:
        """Resume at a sample [ns] by the last words."""
        self.drop_words()
        self.resumed += 1
        return self.begin(stamp_ns, inputs, words)
