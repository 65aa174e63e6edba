"""What drives flights: in lock-step the torque that answers each sample, in real time a clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from quadftc_sim.plant_flight import NEVER_NS, PlantFlight
from quadftc_sim.simulator import Emission, Floats


class Output(Protocol):
    """Takes what a flight emits."""

    def emit(self, emission: Emission) -> None:
        """Show an emission; in real time its truth may wait for `show_truth`."""

    def show_truth(self) -> None:
        """Show what has been waiting."""

    def end(self) -> None:
        """Note that the flight has had its length."""


class PlantDriver:
    """Drives one flight after another.

    Parameters
    ----------
    new_flight : callable
        Returns a flight of an epoch (stamp of its first sample) that begins at a time of the clock [ns].
    output : Output
    lockstep : bool
    clock : callable
        Returns the monotonic time [ns].
    """

    def __init__(
        self,
        new_flight: Callable[[int, int], PlantFlight],
        output: Output,
        lockstep: bool,
        clock: Callable[[], int],
    ) -> None:
        self._new_flight, self._output, self._lockstep = new_flight, output, lockstep
        self._clock = clock
        self._rests_until_ns = 0  # real time: does not emit before, however late
        self.reset()

    @property
    def due_ns(self) -> int:
        """When `tick` is due, by the monotonic clock [ns]; in lock-step never.

        A flight that is late catches up at twice its rate: others have to keep up with it.
        """
        if self._lockstep or not self.flight.emitted:
            return NEVER_NS
        return max(self.flight.due_ns, self._rests_until_ns)

    def reset(self) -> None:
        """Make ready for a new flight."""
        self.flight = self._new_flight(0, self._clock())

    def start(self, epoch_ns: int) -> None:
        """Begin a flight whose first sample has a stamp [ns]."""
        self.flight = self._new_flight(epoch_ns, self._clock())
        if self._lockstep:
            self._advance()
        else:
            self._emit()

    def tick(self) -> None:
        """Real time: emit the next sample; zero torque has acted if none has come for too long."""
        self._rests_until_ns = self._clock() + self.flight.period_ns // 2
        self.flight.wait()
        self._emit()

    def is_due(self) -> bool:
        """Real time: whether a timer is to call `tick`; its clock may drift by half a period from ours."""
        flight = self.flight
        return bool(flight.emitted) and self._clock() + flight.period_ns // 2 >= flight.due_ns

    def take_torque(self, stamp_ns: int, torque: Floats | None) -> None:
        """Fly on under a torque (3,) [N m], None if unusable, that answers the sample of a stamp [ns]."""
        if torque is not None:
            self.flight.command(torque)
        if stamp_ns != self.flight.awaited_ns:
            return
        if self._lockstep:
            self._advance()
        else:
            self._output.show_truth()
            self.flight.fly_ahead()

    def drop(self, stamp_ns: int) -> None:
        """Lock-step: fly on under the last torque, as nobody will answer the sample of a stamp [ns]."""
        if self._lockstep and stamp_ns == self.flight.awaited_ns:
            self._advance()

    def _advance(self) -> None:
        """Emit the next sample that somebody will answer, and what comes before it."""
        self._emit()
        while self.flight.awaited_ns is None and not self.flight.finished:
            self._emit()

    def _emit(self) -> None:
        self._output.show_truth()
        emission = self.flight.emission()
        if emission is None:
            self._output.end()
        else:
            self._output.emit(emission)
