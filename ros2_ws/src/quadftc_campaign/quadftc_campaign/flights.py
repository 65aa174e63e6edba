"""Flight k of a campaign: its drawn values, its scenario, and what the batch engine flies."""

from __future__ import annotations

import zlib
from typing import cast

import numpy as np

from quadftc_campaign.batch.engine import BatchFlight
from quadftc_campaign.batch.judge import Judge
from quadftc_campaign.batch.judged_loop import JudgedLoop
from quadftc_campaign.batch.schedule import schedule_of
from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.distributions import GRID, Value, plain
from quadftc_campaign.errors import CampaignError
from quadftc_flight.closed_loop import loop_of
from quadftc_flight.scenario import MAX_SEED, Document, Scenario, ScenarioError, build_scenario
from quadftc_sim.assembly import sample_count
from quadftc_sim.injection import RESERVED

SEED = "seed"


def drawn(campaign: Campaign, number: int) -> dict[str, Value]:
    """Draw the values of flight ``number`` (from 0), by path, and its seed.

    A value depends on the campaign's seed, the flight's number and the path of the value alone. Neither
    another value nor more flights change it.
    """
    found: dict[str, Value] = {}
    cell = number % campaign.cells
    for path, each in campaign.vary.items():
        if each.kind == GRID:
            found[path] = each.values[cell % len(each.values)]
            cell //= len(each.values)
        else:
            found[path] = each.draw(generator_of(campaign, number, path))
    found[SEED] = int(generator_of(campaign, number, SEED).integers(MAX_SEED))
    return found


def generator_of(campaign: Campaign, number: int, path: str) -> np.random.Generator:
    """Return the random numbers of one value of a flight."""
    return np.random.default_rng([campaign.seed, number, zlib.crc32(path.encode())])


def variant_of(campaign: Campaign, name: str | None) -> Variant:
    """Return a variant by name (the first by default); a `CampaignError` if there is none of that name."""
    for variant in campaign.variants:
        if name in (None, variant.name):
            return variant
    there = ", ".join(variant.name for variant in campaign.variants)
    raise CampaignError(f"{campaign.document.source}: no variant '{name}'; there are: {there}")


def flight_document(campaign: Campaign, number: int) -> Document:
    """Return the scenario of flight ``number`` as plain data, its schemes as they are; raises as below."""
    if not 0 <= number < campaign.flights:
        last = campaign.flights - 1
        raise CampaignError(f"{campaign.document.source}: no flight {number}; there are 0 to {last}")
    values = {path: _schedule(campaign, path, value) for path, value in drawn(campaign, number).items()}
    document = campaign.base.with_values(values, f"flight {number}")
    document.data["name"] = f"{campaign.name[:48]}_flight_{number}"
    return document


def flight_scenario(campaign: Campaign, number: int, variant: Variant) -> Scenario:
    """Build the scenario of flight ``number``, with the scheme of a variant alone.

    A `CampaignError` says that the campaign has no such flight, a `ScenarioError` what is wrong in which.
    """
    try:
        document = flight_document(campaign, number)
        scheme = dict(document.data["schemes"][variant.scheme])
        if variant.observer is not None:
            scheme["observer"] = _replaced(scheme.get("observer"), variant.observer)
        scheme["checks"] = []
        document.data["schemes"] = {variant.scheme: scheme}
        return build_scenario(document)
    except ScenarioError as error:
        lines = (f"flight {number}: {line}" for line in str(error).splitlines())
        raise ScenarioError("\n".join(lines)) from None


def batch_flight(scenario: Scenario, scheme: str | None = None) -> BatchFlight:
    """Return a scenario with one of its schemes (the first by default) as a flight of a batch."""
    loop = loop_of(scenario, scenario.scheme(scheme))
    rotors = loop.vehicle.plant.command_size if loop.flies else 0
    events = (*scenario.fault_events, *scenario.rotor_events)
    judge = Judge(schedule=schedule_of(events, rotors), delay=scenario.sensor.delay)
    count = sample_count(scenario.duration, scenario.rate)
    return BatchFlight(JudgedLoop(loop=loop, judge=judge), scenario.seed, count)


def first_columns(campaign: Campaign, number: int, variant: Variant, scenario: Scenario) -> dict[str, object]:
    """Return what a row of the campaign's table says of its flight before any metric."""
    scheme, is_loop = scenario.scheme(variant.scheme), campaign.source.kind == "loop"
    return {
        "flight": number,
        "variant": variant.name,
        "observer": scheme.observer.kind,
        "disturbance_observer": scheme.disturbance_observer.kind if is_loop else "none",
        "controller": scheme.controller.kind if is_loop else "none",
        **{path: plain(value) for path, value in drawn(campaign, number).items()},
    }


def _schedule(campaign: Campaign, path: str, value: Value) -> Value:
    """A drawn component; a fault keeps the axes and times of the one in its place, unless they are drawn."""
    place, _, index = path.partition(".")
    if place != "faults" or not index.isdecimal() or not isinstance(value, dict):
        return value
    there: list[dict[str, object]] = campaign.base.data.get(place, [])
    kept = there[int(index)] if int(index) < len(there) else {}
    schedule = {key: each for key, each in kept.items() if key in RESERVED}
    return schedule | cast("dict[str, object]", value)


def _replaced(given: object, kind: str) -> object:
    """A part by its name; with the parameters that the scenario gives if it is the one that was there."""
    is_it = isinstance(given, dict) and cast("dict[str, object]", given).get("kind") == kind
    return cast("object", given) if is_it else kind
