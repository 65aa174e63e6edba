"""What every recording of a diagnosis has, whether the vehicle flew or recorded samples were replayed."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from quadftc_bags.bag import Bag
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import Flight
from quadftc_flight.scenario import Fault, Part

NO_OBSERVER = "none"  # kind of an observer that takes its sensor as it is


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Recorded(abc.ABC):
    """What is known of one recording.

    Parameters
    ----------
    name : str
        Of its directory, or of its file.
    path : Path
        As it was given.
    bag : Bag
    parameters : dict
        Node name to its parameters.
    flight : Flight
    summary : dict
        As in ``summary.json``; of a recording that ends early it is about what is there.
    versions : dict
        What it was made with.
    warnings : tuple of str
        One line each.
    """

    name: str
    path: Path
    bag: Bag
    parameters: dict[str, dict[str, Any]]
    flight: Flight
    summary: dict[str, Any]
    versions: dict[str, str]
    warnings: tuple[str, ...] = ()

    @property
    @abc.abstractmethod
    def observer(self) -> str:
        """Name of the fault observer."""

    @property
    @abc.abstractmethod
    def disturbance_observer(self) -> str:
        """Name of the disturbance observer."""

    @property
    @abc.abstractmethod
    def label(self) -> str:
        """What tells it from those that it is compared with."""

    @property
    def own_name(self) -> str:
        """What tells it from another with the same label."""
        return self.name

    @property
    @abc.abstractmethod
    def faults(self) -> tuple[Fault, ...]:
        """Faults by schedule, on any channel."""

    @property
    @abc.abstractmethod
    def fault_events(self) -> tuple[FaultEvent, ...]:
        """When which axis of the attitude is faulty; on some recordings more than `faults` tell."""

    @property
    @abc.abstractmethod
    def disturbances(self) -> tuple[Part, ...]:
        """Disturbances by schedule."""

    @property
    @abc.abstractmethod
    def duration(self) -> float:
        """How much was recorded [s]."""

    @property
    @abc.abstractmethod
    def is_whole(self) -> bool:
        """Whether it was recorded to its end."""


def without_messages(bag: Bag, topics: Iterable[str]) -> list[str]:
    """Return those of the topics, relative to a namespace, that have no message."""
    full = [f"/{name.strip('/')}" for name, topic in bag.topics.items() if topic.count]
    return [topic for topic in topics if not any(name.endswith(f"/{topic}") for name in full)]


def topics_text(bag: Bag) -> str:
    """List the topics that have messages."""
    return ", ".join(sorted(name for name, topic in bag.topics.items() if topic.count)) or "none"


def versions_of(stored: Mapping[str, Any], bag: Bag) -> dict[str, str]:
    """Return what a recording was made with: by its summary, else by the bag."""
    given: Any = stored.get("versions")
    if not isinstance(given, dict):
        given = bag.metadata.get("quadftc", {})
    return {str(key): str(value) for key, value in cast("dict[Any, Any]", given).items() if key != "mode"}
