"""Flight k of a campaign: its values drawn, its scenario, and what the batch engine flies."""

from __future__ import annotations

import copy
import zlib
from typing import Any, NamedTuple, cast

import numpy as np

from quadftc_campaign.batch.parts import FlightParts, flight_parts
from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.distributions import Value
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.scenario import Scenario, ScenarioError, node_parameters
from quadftc_flight.scenario.build import build_scenario
from quadftc_flight.scenario.overrides import with_values
from quadftc_flight.scenario.schema import MAX_SEED
from quadftc_flight.scenario.yaml_document import Document

SEED = "seed"


class Flight(NamedTuple):
    """One flight with one variant."""

    scenario: Scenario
    parts: FlightParts
    events: tuple[FaultEvent, ...]


def drawn(campaign: Campaign, number: int) -> dict[str, Value]:
    """Values of flight ``number`` (from 0), by path, and its seed.

    A value depends on the campaign's seed, the flight's number and the path of the value alone, so that
    neither another value nor more flights change it.
    """
    found: dict[str, Value] = {}
    cell = number % campaign.cells
    for path, each in campaign.vary.items():
        if each.is_grid:
            found[path] = each.values[cell % len(each.values)]
            cell //= len(each.values)
        else:
            found[path] = each.draw(_generator(campaign, number, path))
    found[SEED] = int(_generator(campaign, number, SEED).integers(MAX_SEED))
    return found


def flight_document(campaign: Campaign, number: int, variant: Variant) -> Document:
    """The scenario of flight ``number``, with the scheme of a variant alone."""
    values = dict(drawn(campaign, number))
    document = with_values(campaign.base, values, f"flight {number}")
    scheme = copy.deepcopy(document.data["schemes"][variant.scheme])
    if variant.observer is not None:
        scheme["observer"] = _replaced(scheme.get("observer"), variant.observer)
    if variant.controller is not None:
        scheme["controller"] = _replaced(scheme.get("controller"), variant.controller)
    scheme["checks"] = []
    document.data["schemes"] = {variant.scheme: scheme}
    document.data["name"] = flight_name(campaign, number)
    return document


def flight_name(campaign: Campaign, number: int) -> str:
    """Name of the scenario of flight ``number``."""
    return f"{campaign.name[:48]}_flight_{number}"


def flight(campaign: Campaign, number: int, variant: Variant) -> Flight:
    """Build flight ``number`` with a variant.

    Raises
    ------
    ScenarioError
        If the values drawn make no scenario; the message says of which flight.
    """
    try:
        scenario = build_scenario(flight_document(campaign, number, variant))
        parts = flight_parts(node_parameters(scenario, variant.scheme))
    except ScenarioError as error:
        raise ScenarioError(
            "\n".join(f"flight {number}: {line}" for line in str(error).splitlines())
        ) from None
    return Flight(scenario, parts, scenario.fault_events)


def _replaced(given: Any, kind: str) -> Any:
    """A part by its name; with the parameters given if it is the one that was there."""
    there: Any = cast("dict[str, Any]", given).get("kind") if isinstance(given, dict) else given
    return cast("Any", given) if there == kind else kind


def _generator(campaign: Campaign, number: int, path: str) -> np.random.Generator:
    return np.random.default_rng([campaign.seed, number, zlib.crc32(path.encode())])
