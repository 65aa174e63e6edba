"""A law that never stops the vehicle: in place of what cannot be used it says a fallback, and restarts."""

from __future__ import annotations

import dataclasses
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from quadftc_model.arrays import Flag, branch, finite, where

In = TypeVar("In")
Out = TypeVar("Out")


class RestartingLaw(Protocol[In, Out]):
    """A law that can be guarded."""

    def init(self, inputs: In) -> Any:
        """Return the state at the first sample."""
        ...

    def step(self, state: Any, inputs: In, dt: float) -> tuple[Any, Out]:
        """Advance by ``dt`` [s] to a sample."""
        ...

    def ready(self, inputs: In) -> Flag:
        """Whether the law can start at a sample (...)."""
        ...

    def usable(self, output: Out) -> Flag:
        """Whether an output can be used (...)."""
        ...

    def fallback(self, inputs: In, output: Out) -> Out:
        """Return what is said in place of an output, shaped as it."""
        ...


class GuardedState(NamedTuple):
    """State of a law, and whether it is one to go on from."""

    law: Any
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

    def example(self) -> In:
        """Return inputs of the law as they will come, for the compiler."""
        law: Any = self.law
        return law.example()

    def example_words(self) -> Any:
        """Return last words of the law as they may come, for the compiler; None: it does not resume."""
        return getattr(self.law, "example_words", lambda: None)()

    def init(self, inputs: In) -> GuardedState:
        """Return the state at the first sample."""
        return GuardedState(self.law.init(inputs), ~self.law.ready(inputs))

    def resumed(self, inputs: In, words: Any) -> GuardedState:
        """Return the state that resumes at a sample by last words."""
        law: Any = self.law
        state, ready = law.resumed(inputs, words), self.law.ready(inputs)
        return GuardedState(state, ready & ~ready)

    def step(self, state: GuardedState, inputs: In, dt: Any) -> tuple[GuardedState, GuardedOutput[Out]]:
        """Advance by ``dt`` [s] to a sample."""
        before = branch(state.starts, lambda: self.law.init(inputs), lambda: state.law)
        after, output = self.law.step(before, inputs, where(state.starts, 0.0, dt))
        waits = state.starts & ~self.law.ready(inputs)
        failed = ~(waits | (self.law.usable(output) & finite(after, waits.ndim)))
        starts = waits | failed
        said = branch(starts, lambda: self.law.fallback(inputs, output), lambda: output)
        return GuardedState(after, starts), GuardedOutput(said, failed, starts)
