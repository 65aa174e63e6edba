"""Faults that are put on a recording: from the command line, and from a YAML file.

The file holds the key ``faults`` of a scenario file, or is one; its other keys are passed over. Times count
from the first sample.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import BaseModel, ValidationError

from quadftc_flight import fault_schedule, scenario
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow
from quadftc_flight.scenario import Fault, Problem, Scenario, ScheduledFault, Setting
from quadftc_model.hints import nearest
from quadftc_model.spec import parse_spec
from quadftc_replay.imu_recording import Recording
from quadftc_sim.assembly import injection_from
from quadftc_sim.injection import RESERVED, ask_for_size, ask_for_units


@dataclasses.dataclass(frozen=True, eq=False)
class OverlaidFault(Fault):
    """A fault that is put on a recording, and how it was asked for."""

    said: str  # the specification that was given; of a fault from a file its `spec`


def faults_from(files: Iterable[Path], specs: Iterable[str]) -> tuple[OverlaidFault, ...]:
    """Build the faults of the files, and after them those of the specifications.

    A specification is such as ``bias axis=roll value=3deg start=60s stop=80s``. A ValueError says which one
    is wrong, and what was expected.
    """
    read = (fault for file in files for fault in _read_faults(file))
    return (
        *(OverlaidFault(fault.injection, fault.given, fault.spec) for fault in read),
        *map(_parse_fault, specs),
    )


def replay_windows(recording: Recording, faults: Sequence[Fault]) -> tuple[FaultWindow, ...]:
    """When the attitude is faulty, by what was recorded and by what was overlaid."""
    overlaid = fault_schedule.fault_windows(faults, recording.duration)
    return fault_schedule.merge_windows([*recording.fault_windows, *overlaid])


def replay_events(recording: Recording, faults: Sequence[Fault]) -> tuple[FaultEvent, ...]:
    """Faults of each sensor axis by axis, by what was recorded and by what was overlaid."""
    overlaid = fault_schedule.fault_events(faults, recording.duration)
    return fault_schedule.merge_events([*recording.fault_events, *overlaid])


def _parse_fault(spec: str) -> OverlaidFault:
    injection, (kind, values) = injection_from(spec), parse_spec(spec)
    try:
        ask_for_units(kind, values)
        ask_for_size(kind, values)
    except ValueError as error:
        raise ValueError(f"fault '{spec}': {error}") from None
    return OverlaidFault(injection, tuple(name for name in values if name not in RESERVED), spec)


class _FaultsFile(BaseModel):
    faults: tuple[ScheduledFault, ...] = ()


def _read_faults(file: Path) -> tuple[Fault, ...]:
    document, known = scenario.read_document(file), scenario.keys_of(Scenario)
    problems = [
        Problem((key,), f"unknown key{nearest(key, known)}; expected 'faults', as in a scenario file")
        for key in document.data
        if key not in known
    ]
    if not document.data.get("faults"):
        problem = "no faults; expected the key 'faults' with a list, as in a scenario file"
        problems.append(Problem((), problem))
    try:
        faults = _FaultsFile.model_validate(document.data, context=Setting(document)).faults
    except ValidationError as error:
        raise document.error([*problems, *scenario.problems_of(error, lambda _: Scenario)]) from None
    if problems:
        raise document.error(problems)
    return faults
