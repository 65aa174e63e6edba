"""A scenario: one experiment, checked and with every part built."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping
from typing import Any, cast

from quadftc_flight.fault_schedule import FaultEvent, FaultWindow, fault_events, fault_windows
from quadftc_flight.scenario.yaml_document import Document, ScenarioError
from quadftc_model.hints import nearest
from quadftc_model.samples import AXES
from quadftc_model.spec import format_spec
from quadftc_sim.injection import Injection
from quadftc_sim.plant import Plant
from quadftc_sim.sensors import ImuSensor


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """A component: its name, the component itself, and which of its parameters the file gives."""

    kind: str
    law: Any = dataclasses.field(repr=False)
    given: tuple[str, ...]

    @property
    def spec(self) -> str:
        """The specification, in SI, from which the same component can be built."""
        return format_spec(self.kind, {name: _compact(getattr(self.law, name)) for name in self.given})


@dataclasses.dataclass(frozen=True, eq=False)
class Fault:
    """A scheduled fault, and which parameters of its law the file gives."""

    injection: Injection
    given: tuple[str, ...]

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes it is on, named as roll, pitch, yaw on every channel."""
        return tuple(name for name, acts in zip(AXES, self.injection.mask, strict=True) if acts)

    @property
    def spec(self) -> str:
        """The specification, in SI, from which the same injection can be made."""
        injection = self.injection
        values: dict[str, Any] = {"channel": injection.channel}
        if len(self.axes) < len(AXES):
            values["axes"] = self.axes
        values["start"] = injection.start
        if math.isfinite(injection.stop):
            values["stop"] = injection.stop
        values.update({name: _compact(getattr(injection.law, name)) for name in self.given})
        return format_spec(injection.kind, values)


@dataclasses.dataclass(frozen=True)
class Check:
    """A bound on a metric of ``summary["metrics"]``; without an axis it holds for each.

    Parameters
    ----------
    metric : str
        Dotted path.
    axis : str, optional
    above, below : float, optional
        Bounds, exclusive; at least one is given.
    """

    metric: str
    axis: str | None
    above: float | None
    below: float | None


@dataclasses.dataclass(frozen=True, eq=False)
class Scheme:
    """Two observers and a controller, and what is required of them."""

    name: str
    observer: Part
    disturbance_observer: Part
    controller: Part
    checks: tuple[Check, ...]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Scenario:
    """One experiment: a vehicle, its sensors, what happens to it, and the schemes that shall cope with it."""

    name: str
    description: str
    duration: float  # [s]
    rate: float  # [Hz]
    seed: int
    vehicle: str  # name, or absolute path of a TOML file
    plant: Plant  # without the disturbances
    sensor: ImuSensor
    references: tuple[Part, ...]
    disturbances: tuple[Part, ...]
    faults: tuple[Fault, ...]
    schemes: Mapping[str, Scheme]  # the first is the default
    document: Document = dataclasses.field(repr=False)

    @property
    def text(self) -> str:
        """The text of the scenario file, without overrides."""
        return self.document.text

    @property
    def raw(self) -> dict[str, Any]:
        """The scenario as plain data, overrides applied."""
        return copy.deepcopy(self.document.data)

    def scheme(self, name: str | None = None) -> Scheme:
        """Return a scheme by name; the first by default.

        Raises
        ------
        ScenarioError
            If there is none of that name.
        """
        if name is None:
            return next(iter(self.schemes.values()))
        if name not in self.schemes:
            there = ", ".join(self.schemes)
            raise ScenarioError(
                f"{self.document.source}: no scheme '{name}'{nearest(name, self.schemes)}; there are: {there}"
            )
        return self.schemes[name]

    @property
    def fault_windows(self) -> tuple[FaultWindow, ...]:
        """When the attitude is faulty by schedule: every distinct pair of start and stop [s], in order."""
        return fault_windows(self.faults, self.duration)

    @property
    def fault_events(self) -> tuple[FaultEvent, ...]:
        """The scheduled faults of the attitude, axis by axis, with their kind."""
        return fault_events(self.faults, self.duration)


def _compact(value: Any) -> Any:
    """One number for a vector of equal numbers."""
    if not isinstance(value, tuple):
        return value
    numbers = cast("tuple[Any, ...]", value)
    return numbers[0] if len(set(numbers)) == 1 else numbers
