"""Faults that are put on a recording: from the command line, and from a YAML file.

The file holds the key ``faults`` of a scenario file, or is one; its other keys are passed over. Times count
from the first sample.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import BaseModel, ValidationError

from quadftc_flight.scenario import (
    Fault,
    Problem,
    Scenario,
    ScheduledFault,
    Setting,
    keys_of,
    problems_of,
    read_document,
)
from quadftc_model.hints import nearest
from quadftc_model.spec import parse_spec
from quadftc_sim.assembly import injection_from
from quadftc_sim.injection import RESERVED, Injection
from quadftc_sim.injector import FaultInjector


def faults_from(files: Iterable[Path], specs: Iterable[str]) -> tuple[Fault, ...]:
    """Build the faults of the files, and behind them those of the specifications.

    Parameters
    ----------
    files : iterable of Path
    specs : iterable of str
        Such as ``bias axis=roll value=3deg start=60s stop=80s``.

    Raises
    ------
    ValueError
        If one is wrong; the message says which, and what was expected.
    """
    return (*(fault for file in files for fault in _faults_of(file)), *(_fault_of(spec) for spec in specs))


def require_within(faults: Sequence[Fault], duration: float, where: str) -> None:
    """Refuse a fault that would not act.

    Raises
    ------
    ValueError
        If one starts behind the end of the recording [s].
    """
    for fault in faults:
        if fault.injection.start >= duration:
            raise ValueError(
                f"fault '{fault.spec}': start = {fault.injection.start:g} s: must be before the end of"
                f" {where}, {duration:.3f} s"
            )


def injector_of(faults: Iterable[Fault], seed: int) -> FaultInjector:
    """Return the injector that puts these faults on the samples."""
    injector = FaultInjector(seed)
    for fault in faults:
        injector.add(fault.injection)
    return injector


def _fault_of(spec: str) -> Fault:
    injection: Injection = injection_from(spec)
    return Fault(injection, tuple(name for name in parse_spec(spec).values if name not in RESERVED))


class _FaultsFile(BaseModel):
    faults: tuple[ScheduledFault, ...] = ()


def _faults_of(file: Path) -> tuple[Fault, ...]:
    document, known = read_document(file), keys_of(Scenario)
    problems = [
        Problem((key,), f"unknown key{nearest(key, known)}; expected 'faults', as in a scenario file")
        for key in document.data
        if key not in known
    ]
    if not document.data.get("faults"):
        problems.append(
            Problem((), "no faults; expected the key 'faults' with a list, as in a scenario file")
        )
    try:
        faults = _FaultsFile.model_validate(document.data, context=Setting(document)).faults
    except ValidationError as error:
        raise document.error([*problems, *problems_of(error, lambda _: Scenario)]) from None
    if problems:
        raise document.error(problems)
    return faults
