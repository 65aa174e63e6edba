"""What a bag is a recording of: scenario, parameters and scheme, attached to it or beside it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import yaml

from quadftc_bags.bag import Bag, BagError
from quadftc_flight.scenario import Scenario, ScenarioError, Scheme, node_parameters, parse_scenario

SCENARIO, PARAMETERS, SUMMARY = "scenario.yaml", "parameters.yaml", "summary.json"
DESCRIPTION = "replay.yaml"  # in place of the scenario: what was replayed

# what `parsed_parameters` raises of a text that is no ROS parameter file
NO_PARAMETERS = (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError, RecursionError)

_ROLES = {
    "observer": ("fault_observer", "observer"),
    "disturbance_observer": ("disturbance_observer", "observer"),
    "controller": ("controller", "controller"),
}  # part of a scheme -> node, and the parameter that names the component

Parameters = dict[str, dict[str, Any]]


class Origin(NamedTuple):
    """What was flown."""

    scenario: Scenario
    scheme: Scheme
    parameters: Parameters
    warnings: list[str]


def run_name(path: Path) -> str:
    """Name of a run: its directory's, or its file's."""
    return path.stem.removesuffix("_0") if path.is_file() else path.resolve().name


def beside(path: Path, name: str) -> Path:
    """Return the file of that name beside a bag (directory or file)."""
    return (path if path.is_dir() else path.parent) / name


def attached_text(bag: Bag, name: str) -> str | None:
    """Return an attachment, else the file beside the bag; None if there is neither.

    Raises
    ------
    BagError
        If it cannot be read.
    """
    file = beside(bag.path, name)
    try:
        data = bag.attachments.get(name) or (file.read_bytes() if file.is_file() else b"")
        return data.decode("utf-8") or None
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"{bag.path}: {name} cannot be read: {error}") from None


def is_replay(bag: Bag) -> bool:
    """Whether a bag, or a file beside it, says that it is a replay of a recording, not a flight."""
    return attached_text(bag, DESCRIPTION) is not None


def read_origin(bag: Bag, stored: Mapping[str, Any]) -> Origin:
    """Find out what was flown; parameters that are lost are compiled from the scenario, with a warning.

    Parameters
    ----------
    bag : Bag
        With a scenario, attached or beside it.
    stored : mapping
        The summary beside the bag; may be empty.

    Raises
    ------
    BagError
        If the scenario cannot be used, or it is not known which of its schemes was flown.
    """
    warnings: list[str] = []
    name = run_name(bag.path)
    parameters = _parameters(attached_text(bag, PARAMETERS), bag.path, warnings)
    scenario = _scenario(attached_text(bag, SCENARIO) or "", parameters, bag.path)
    scheme = _scheme(scenario, parameters, (str(stored.get("scheme", "")), name), bag.path)
    if "name" not in scenario.raw:  # then it was the file's
        scenario = dataclasses.replace(scenario, name=name.removesuffix(f"-{scheme.name}"))
    if not parameters:
        parameters = {node: dict(values) for node, values in node_parameters(scenario, scheme).items()}
    return Origin(scenario, scheme, parameters, warnings)


def _parameters(text: str | None, path: Path, warnings: list[str]) -> Parameters:
    if text is None:
        warnings.append(f"{path}: {PARAMETERS} is missing; took the parameters that the scenario gives")
        return {}
    try:
        return parsed_parameters(text)
    except NO_PARAMETERS:
        warnings.append(f"{path}: {PARAMETERS} makes no sense; took the parameters that the scenario gives")
        return {}


def parsed_parameters(text: str) -> Parameters:
    """Read a ROS parameter file: the name of each node, without its namespace, to its parameters.

    Raises
    ------
    One of NO_PARAMETERS
        If it is no such file.
    """
    data: Any = yaml.safe_load(text)
    return {
        str(node).rpartition("/")[2]: dict(entry["ros__parameters"])
        for node, entry in cast("dict[str, Any]", data).items()
    }


def _scenario(text: str, parameters: Parameters, path: Path) -> Scenario:
    """Parse the scenario; a vehicle's file, which it names from where it lay, is found by the parameters."""
    vehicle = parameters.get("plant", {}).get("vehicle")
    overrides = [f"vehicle={vehicle}"] if isinstance(vehicle, str) and vehicle.endswith(".toml") else []
    try:
        return parse_scenario(text, str(path / SCENARIO), overrides)
    except ScenarioError as error:
        first, *others = str(error).splitlines()
        raise BagError(f"{first} (and {len(others)} more)" if others else first) from None


def _scheme(scenario: Scenario, parameters: Parameters, names: tuple[str, str], path: Path) -> Scheme:
    """Tell which scheme was flown: the parameters name its components; the summary or the run names it."""
    fitting = [scheme for scheme in scenario.schemes.values() if _kinds_fit(scheme, parameters)]
    if not fitting:
        raise BagError(f"{path}: {PARAMETERS} fits none of the schemes {', '.join(scenario.schemes)}")
    by_summary, by_run = names
    for narrower in (
        [scheme for scheme in fitting if parameters and _values_fit(scenario, scheme, parameters)],
        [scheme for scheme in fitting if scheme.name == by_summary],
        [scheme for scheme in fitting if by_run.endswith(f"-{scheme.name}")],
    ):
        both = [scheme for scheme in fitting if scheme in narrower]
        fitting = both or fitting
    if len(fitting) > 1:
        raise BagError(
            f"{path}: which of the schemes {', '.join(scheme.name for scheme in fitting)} was flown is not"
            f" known; expected {PARAMETERS}, 'scheme' in {SUMMARY}, or a name that ends with it"
        )
    return fitting[0]


def _kinds_fit(scheme: Scheme, parameters: Parameters) -> bool:
    return all(
        parameters.get(node, {}).get(selector, getattr(scheme, role).kind) == getattr(scheme, role).kind
        for role, (node, selector) in _ROLES.items()
    )


def _values_fit(scenario: Scenario, scheme: Scheme, parameters: Parameters) -> bool:
    compiled = node_parameters(scenario, scheme)
    return all(
        parameters.get(node, {}).get(name, value) == value
        for node, _ in _ROLES.values()
        for name, value in compiled[node].items()
    )
