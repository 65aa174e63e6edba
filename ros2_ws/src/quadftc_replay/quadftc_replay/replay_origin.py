"""What a bag is a replay of: the description that `quadftc replay` attaches to it, and the parameters."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from quadftc_bags.bag import Bag, BagError
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow
from quadftc_flight.run_origin import (
    DESCRIPTION,
    NO_PARAMETERS,
    PARAMETERS,
    Parameters,
    attached_text,
    parsed_parameters,
)
from quadftc_flight.scenario import Fault
from quadftc_replay.overlay import faults_from

Axis = Literal["roll", "pitch", "yaw"]
Count = Annotated[int, Field(ge=0)]
Time = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class ReplayOrigin(NamedTuple):
    """What was replayed.

    Parameters
    ----------
    recording, topic : str
        Name of the recording, full name of the topic of its IMU.
    observer : str
    faults : tuple of Fault
        Overlaid.
    seed : int
        Of the overlaid faults.
    truth, torque : str
        What the estimates are compared with, and which torque the observer was told; in words.
    duration : float
        Of the recording [s].
    samples : int
        That were replayed, withheld ones among them.
    left_out : dict
        Reason to the number of recorded samples that were not replayed.
    fault_windows : tuple of FaultWindow
    fault_events : tuple of FaultEvent
        When the attitude is faulty, by what was recorded and by what was overlaid.
    parameters : dict
        Node name to its parameters.
    """

    recording: str
    topic: str
    observer: str
    faults: tuple[Fault, ...]
    seed: int
    truth: str
    torque: str
    duration: float
    samples: int
    left_out: dict[str, int]
    fault_windows: tuple[FaultWindow, ...]
    fault_events: tuple[FaultEvent, ...]
    parameters: Parameters


class _Shape(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True)


class _Window(_Shape):
    start: Time
    stop: Time
    axes: list[Axis]


class _Event(_Shape):
    axis: Axis
    kind: str
    start: Time
    stop: Time


class _Description(_Shape):
    recording: str
    topic: str
    observer: str
    faults: list[str]
    seed: int
    truth: str
    torque: str
    duration: Time
    samples: Count
    samples_left_out: dict[str, Count]
    fault_windows: list[_Window]
    fault_events: list[_Event]


def read_replay_origin(bag: Bag) -> ReplayOrigin:
    """Read what was replayed.

    Raises
    ------
    BagError
        If the bag does not say it, or what it says makes no sense; one line.
    """
    given = _description(bag)
    try:
        faults = faults_from((), given.faults)
    except ValueError as error:
        raise BagError(f"{bag.path}: {DESCRIPTION}: {error}") from None
    return ReplayOrigin(
        recording=given.recording,
        topic=given.topic,
        observer=given.observer,
        faults=faults,
        seed=given.seed,
        truth=given.truth,
        torque=given.torque,
        duration=given.duration,
        samples=given.samples,
        left_out=given.samples_left_out,
        fault_windows=tuple(
            FaultWindow(item.start, item.stop, tuple(item.axes)) for item in given.fault_windows
        ),
        fault_events=tuple(
            FaultEvent(item.axis, item.kind, item.start, item.stop) for item in given.fault_events
        ),
        parameters=_parameters(bag),
    )


def _description(bag: Bag) -> _Description:
    try:
        data: Any = yaml.safe_load(attached_text(bag, DESCRIPTION) or "")
        return _Description.model_validate(data)
    except (yaml.YAMLError, RecursionError):
        raise BagError(f"{bag.path}: {DESCRIPTION} is no YAML") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the file"
        raise BagError(f"{bag.path}: {DESCRIPTION}: {place}: {first['msg']}") from None


def _parameters(bag: Bag) -> Parameters:
    text = attached_text(bag, PARAMETERS)
    if text is None:
        raise BagError(f"{bag.path}: a replay without {PARAMETERS} (attached to the bag, or beside it)")
    try:
        return parsed_parameters(text)
    except NO_PARAMETERS:
        raise BagError(f"{bag.path}: {PARAMETERS} makes no sense; expected a ROS parameter file") from None
