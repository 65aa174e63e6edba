"""Which fault observer diagnoses a recording: the one asked for, or the one that did when it was recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from quadftc_bags.bag import BagError
from quadftc_fdi.fault_observer import FaultObserver, fault_observer_from, fault_observers
from quadftc_flight.scenario import parse_value
from quadftc_model.assembly import get, node_values
from quadftc_replay.recording import Recording

DEFAULT_OBSERVER = "supervised"
DEFAULT_VEHICLE = "qball_x4"
PREFIX = "observer."


class ChosenObserver(NamedTuple):
    """A fault observer, and the parameters of the node that would run it: all of them, in SI."""

    name: str
    law: FaultObserver
    parameters: dict[str, Any]


def choose_observer(
    recording: Recording, name: str = "", vehicle: str = "", settings: Sequence[str] = ()
) -> ChosenObserver:
    """Build the fault observer.

    Parameters
    ----------
    recording : Recording
    name : str
        Of the observer, which then has its defaults; empty: as in the recording, else `DEFAULT_OBSERVER`.
    vehicle : str
        Name, or path of a TOML file; empty: as in the recording, else `DEFAULT_VEHICLE`.
    settings : sequence of str
        ``observer.<parameter>=value``, with a unit if need be.

    Raises
    ------
    ValueError
        If there is no such observer or vehicle, or a parameter is wrong.
    """
    recorded = _recorded(recording, name)
    parameters: dict[str, Any] = {
        "vehicle": recorded.get("vehicle", DEFAULT_VEHICLE),
        "observer": name or recorded.get("observer", DEFAULT_OBSERVER),
    }
    kind = get(parameters, "observer", str)
    fault_observers.get(kind)
    if vehicle:
        parameters["vehicle"] = str(Path(vehicle).resolve()) if vehicle.endswith(".toml") else vehicle
    if not name:
        parameters |= {key: value for key, value in recorded.items() if key.startswith(f"{kind}.")}
    for setting in settings:
        parameters |= _setting(kind, setting)
    as_recorded = recorded and not (name or vehicle or settings)
    law = _build(parameters, f"{recording.path}: parameters.yaml: " if as_recorded else "")
    full = {"vehicle": parameters["vehicle"], "observer": kind, **node_values(law, kind)}
    return ChosenObserver(kind, law, full)


def _recorded(recording: Recording, name: str) -> Mapping[str, Any]:
    if recording.observer is None and not name:
        raise BagError(f"{recording.path}: parameters.yaml makes no sense; choose with --observer")
    return recording.observer or {}


def _build(parameters: Mapping[str, Any], where: str) -> FaultObserver:
    try:
        return fault_observer_from(parameters)
    except ValueError as error:
        raise ValueError(f"{where}{error}") from None


def _setting(kind: str, text: str) -> dict[str, Any]:
    target, equals, value = text.partition("=")
    parameter = target.strip().removeprefix(PREFIX)
    if not equals or not target.strip().startswith(PREFIX) or not parameter:
        raise ValueError(f"--set {text!r}: expected {PREFIX}<parameter>=value")
    return {f"{kind}.{parameter}": parse_value(value, f"--set {text!r}")}
