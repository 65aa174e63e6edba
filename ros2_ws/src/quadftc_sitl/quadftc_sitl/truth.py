"""The faults that a flight really had: those of its scenario, and those that somebody put on and took off."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from quadftc_flight.scenario import Fault
from quadftc_model.parameters import parameters_of
from quadftc_sim.injection import Injection
from quadftc_sim.injector import FaultInjector

MICROSECOND = 6  # digits of a time [s]


class NotedInjector(FaultInjector):
    """A fault injector that notes what it did."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._noted: dict[int, Fault] = {}

    def add(self, injection: Injection, given: Sequence[str] | None = None) -> int:
        """Schedule an injection; ``given`` are the parameters that are noted, by default all."""
        number = super().add(injection)
        names = [each.name for each in parameters_of(injection.law.__class__)] if given is None else given
        self._noted[number] = Fault(injection, tuple(names))
        return number

    def clear(self, number: int = 0) -> int:
        """End one injection, or all (0); what has not begun has never been."""
        for known in self.injections:
            if number in (0, known):
                fault = self._noted.pop(known)
                if fault.injection.start <= self.now:
                    ended = dataclasses.replace(fault.injection, stop=self.now)
                    self._noted[known] = dataclasses.replace(fault, injection=ended)
        return super().clear(number)

    def noted(self, zero: float = 0.0) -> dict[int, Fault]:
        """Return the faults by number, their times from a moment of the injector's clock on [s]."""
        return {
            number: dataclasses.replace(fault, injection=shifted(fault.injection, -zero, MICROSECOND))
            for number, fault in sorted(self._noted.items())
        }

    def begun_since(self, zero: float) -> list[Fault]:
        """Return those that have begun, as `noted` does."""
        return [fault for fault in self.noted(zero).values() if fault.injection.start <= self.now - zero]


def shifted(injection: Injection, time: float, digits: int | None = None) -> Injection:
    """Return an injection that is later by a time [s]; its times may be rounded to so many digits."""
    start, stop = injection.start + time, injection.stop + time
    if digits is not None:
        start, stop = round(start, digits), round(stop, digits)
    return dataclasses.replace(injection, start=start, stop=stop)
