"""Running a law on a stream of stamped samples: the first sample starts it, stamps give the time step.

The ROS nodes and the closed loop without ROS run their laws through this one class. So both treat repeated
stamps, stamps that go back, and gaps alike.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

In_contra = TypeVar("In_contra", contravariant=True)
Out_co = TypeVar("Out_co", covariant=True)
In = TypeVar("In")
Out = TypeVar("Out")

NANOSECONDS_PER_SECOND = 1e9
MAX_GAP = 1.0  # s; over a longer gap nothing can be carried: the law restarts


def seconds(nanoseconds: int) -> float:
    """Seconds of a whole number of nanoseconds, correctly rounded: 4 000 000 ns are the float 0.004."""
    return nanoseconds / NANOSECONDS_PER_SECOND


class Law(Protocol[In_contra, Out_co]):
    """A law: explicit state, no clock, no memory of its own; its parameters are the fields of the object."""

    def init(self, inputs: In_contra) -> object:
        """Return the state at the first sample; states keep their structure from here on."""
        ...

    def step(self, state: Any, inputs: In_contra, dt: float) -> tuple[object, Out_co]:
        """Advance by ``dt`` [s] to the sample ``inputs``; ``dt`` is 0 at the first sample."""
        ...


class Runner(Protocol[In_contra, Out_co]):
    """Runs a law for one vehicle, in NumPy or in C; states are its own, `tree` shows them."""

    def first(self, inputs: In_contra) -> tuple[object, Out_co]:
        """Return state and output at the first sample."""
        ...

    def resumed(self, inputs: In_contra, words: object) -> tuple[object, Out_co]:
        """Return state and output at a sample from which the law resumes by last words."""
        ...

    def step(self, state: object, inputs: In_contra, dt: float) -> tuple[object, Out_co]:
        """Advance by ``dt`` [s] to a sample."""
        ...

    def tree(self, state: object) -> Any:
        """Return the nested tuples of a state."""
        ...

    def configure(self, law: object) -> bool:
        """Go on with another law of the same structure, from the same states; False: it cannot."""
        ...


class NumpyRunner(Generic[In, Out]):
    """Runs a law in NumPy: the reference."""

    def __init__(self, law: object) -> None:
        self._law: Any = law

    def first(self, inputs: In) -> tuple[object, Out]:
        """Return state and output at the first sample."""
        with np.errstate(all="ignore"):
            return self._law.step(self._law.init(inputs), inputs, 0.0)

    def resumed(self, inputs: In, words: object) -> tuple[object, Out]:
        """Return state and output at a sample from which the law resumes by last words."""
        with np.errstate(all="ignore"):
            return self._law.step(self._law.resumed(inputs, words), inputs, 0.0)

    def step(self, state: object, inputs: In, dt: float) -> tuple[object, Out]:
        """Advance by ``dt`` [s] to a sample."""
        with np.errstate(all="ignore"):
            return self._law.step(state, inputs, dt)

    def tree(self, state: object) -> Any:
        """Return the state."""
        return state

    def configure(self, law: object) -> bool:
        """Go on with another law of the same kind."""
        if type(law) is not type(self._law):
            return False
        self._law = law
        return True


Engine = Callable[[object], Runner[Any, Any]]  # what runs a law


class Stepper(Generic[In, Out]):
    """One law with its state and the stamp of its last sample; ``engine`` says what runs the law."""

    def __init__(self, law: Law[In, Out], engine: Engine = NumpyRunner) -> None:
        self._engine = engine
        self.law = law
        self.reset()

    @property
    def law(self) -> Law[In, Out]:
        """The law; another one goes on with the state of the one before."""
        return self._law

    @law.setter
    def law(self, law: Law[In, Out]) -> None:
        run = self._run_law(law)
        if not (hasattr(self, "_runner") and self._runner.configure(run)):
            self._runner: Runner[In, Any] = self._engine(run)
        self._law = law

    def replace_law(self, law: Law[In, Out], example: In) -> None:
        """Go on with another law in flight: in NumPy, if it would have to be compiled for inputs first."""
        run, is_ready = self._run_law(law), getattr(self._engine, "is_ready", None)
        quick: Engine = self._engine if is_ready is None or is_ready(run, example) else NumpyRunner
        state = None if self._state is None else self._runner.tree(self._state)
        self._law, self._runner, self._state = law, quick(run), state

    def _run_law(self, law: Any) -> object:
        """Return what is run of a law."""
        return law

    def reset(self) -> None:
        """Forget the state; the next sample is the first."""
        self._state: object = None
        self.stamp_ns: int | None = None

    @property
    def state(self) -> Any:
        """State of the law at the last sample; None before the first."""
        return None if self._state is None else self._runner.tree(self._state)

    def begin(self, stamp_ns: int, inputs: In, words: object = None) -> Out:
        """Start at a sample [ns]; from what another law has said last, if that is given."""
        begun = self._runner.first(inputs) if words is None else self._runner.resumed(inputs, words)
        return self._keep(stamp_ns, begun)

    def time_step(self, stamp_ns: int) -> float | None:
        """Return the time step [s] to a sample [ns]; None if its stamp repeats or went back: it is refused.

        It is 0 where the law starts: at the first sample, and after a gap or a jump of the clock.
        """
        if self.stamp_ns is None:
            return 0.0
        elapsed = seconds(stamp_ns - self.stamp_ns)
        if abs(elapsed) > MAX_GAP:
            return 0.0
        return elapsed if elapsed > 0.0 else None

    def step(self, stamp_ns: int, inputs: In) -> Out | None:
        """Advance the law to a sample [ns]; None if it is refused."""
        dt = self.time_step(stamp_ns)
        if dt is None:
            return None
        if dt == 0.0:
            return self.begin(stamp_ns, inputs)
        return self._keep(stamp_ns, self._runner.step(self._state, inputs, dt))

    def _keep(self, stamp_ns: int, stepped: tuple[object, Any]) -> Out:
        """Keep the state; return what is said."""
        self._state, output = stepped
        self.stamp_ns = stamp_ns
        return output
