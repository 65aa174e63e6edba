"""Several laws that act together: which law gets what of which.

A composition only moves values between laws; whatever is computed, a law computes. So one description serves
to fly in NumPy and in C, law by law, and to be traced as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

import numpy as np

from quadftc_model.arrays import Flag, Scalar, branch
from quadftc_model.stepper import Engine

T = TypeVar("T")


class Calls(Protocol):
    """How a composition calls its laws."""

    def init(self, name: str) -> object:
        """Return a state of a law to begin with: that at its example."""
        ...

    def step(self, name: str, state: object, inputs: object, dt: Scalar) -> tuple[object, Any]:
        """Step a law by ``dt`` [s]; where that is 0, the law begins."""
        ...

    def branch(self, flag: Flag, then: Callable[[], T], otherwise: Callable[[], T]) -> T:
        """Return ``then()`` where a flag holds and ``otherwise()`` elsewhere, nested tuples alike."""
        ...


class Composition(Protocol):
    """Laws by name, and a step that calls them."""

    @property
    def laws(self) -> Mapping[str, Any]:
        """The laws; each has an ``example()`` of its inputs."""
        ...

    def init(self, calls: Calls) -> object:
        """Return a state to begin with."""
        ...

    def step(self, calls: Calls, state: Any, inputs: Any) -> tuple[object, object]:
        """Advance to the next sample."""
        ...


class PlainCalls:
    """Calls the laws as they are, for one vehicle or many."""

    def __init__(self, laws: Mapping[str, Any]) -> None:
        self._laws = laws

    def init(self, name: str) -> object:
        """Return the state of a law at its example."""
        return self._laws[name].init(self._laws[name].example())

    def step(self, name: str, state: object, inputs: object, dt: Scalar) -> tuple[object, Any]:
        """Step a law by ``dt`` [s]; where that is 0, the law begins."""
        law = self._laws[name]
        before = branch(dt == 0.0, lambda: law.init(inputs), lambda: state)
        return law.step(before, inputs, dt)

    def branch(self, flag: Flag, then: Callable[[], T], otherwise: Callable[[], T]) -> T:
        """Return ``then()`` where a flag holds and ``otherwise()`` elsewhere."""
        return branch(flag, then, otherwise)


class RunnerCalls(PlainCalls):
    """Calls what runs the laws of one vehicle, each by itself."""

    def __init__(self, laws: Mapping[str, Any], engine: Engine) -> None:
        super().__init__(laws)
        self._runners = {name: engine(law) for name, law in laws.items()}
        self._states: dict[str, object] = {}  # at their last steps

    def init(self, name: str) -> object:
        """Return the state of a law at its example."""
        with np.errstate(all="ignore"):
            return super().init(name)

    def step(self, name: str, state: object, inputs: object, dt: Scalar) -> tuple[object, Any]:
        """Step a law by ``dt`` [s]; where that is 0, the law begins."""
        runner = self._runners[name]
        after = runner.first(inputs) if dt == 0.0 else runner.step(state, inputs, float(dt))
        self._states[name] = after[0]
        return after

    def state_of(self, name: str) -> Any:
        """Return the state of a law at its last step."""
        return self._runners[name].tree(self._states[name])
