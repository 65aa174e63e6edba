"""A campaign file with `source: sitl`: a firmware flies its scenario, values drawn as for any campaign.

>>> flights = campaign_flights(Path("campaigns/sitl_hover.yaml"), "ardupilot")
>>> flights[0].plan.name, flights[0].drawn
('gyro_stuck-0', {'faults.0.kind': 'stuck', ..., 'faults.0.start': 4.84..., 'wind.1.wind_speed': 7.55...})
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, cast

from quadftc_campaign.campaign_file import load_campaign
from quadftc_campaign.distributions import plain
from quadftc_campaign.flights import SEED, drawn, flight_document
from quadftc_flight.scenario import Document, Scenario, ScenarioError, changed_document, read_document
from quadftc_sitl.plan import SitlPlan, plan_of, plans_of_catalogue
from quadftc_sitl.scoring import describe_faults

LONGEST = 48  # characters of what a flight is named after


class CampaignFlight(NamedTuple):
    """A flight of a campaign, and what was drawn for it, by path."""

    plan: SitlPlan
    drawn: Mapping[str, object]


def campaign_flights(
    path: Path,
    autopilot: str,
    flights: int | None = None,
    seed: int | None = None,
    assignments: Sequence[str] = (),
) -> list[CampaignFlight]:
    """Build the flights of a campaign, each named after what is faulty and its number.

    ``flights`` and ``seed`` count in place of the file's, ``assignments`` come after its ``set``. A
    ScenarioError says what is wrong in the file, or what drawn values make no scenario.
    """

    def build(document: Document) -> Scenario:
        return plan_of(document, autopilot=autopilot).scenario

    campaign = load_campaign(path, flights, seed=seed, assignments=assignments, build=build)
    scheme = campaign.variants[0].scheme
    found: list[CampaignFlight] = []
    for number in range(campaign.flights):
        document = flight_document(campaign, number)
        document.data["name"] = f"{_faulty(plan_of(document, scheme, autopilot))}-{number}"
        values = dict(_told(drawn(campaign, number)))
        found.append(CampaignFlight(plan_of(document, scheme, autopilot), values))
    return found


def _told(values: Mapping[str, object]) -> Iterator[tuple[str, object]]:
    """Yield what the report tells of drawn values; of components texts, as their numbers differ in unit."""
    for path, value in values.items():
        if isinstance(value, Mapping):
            parts = ((key, plain(each)) for key, each in cast("Mapping[str, object]", value).items())
            yield from ((f"{path}.{key}", each) for key, each in parts if not isinstance(each, float))
        elif path != SEED:
            yield path, plain(value)


def _faulty(plan: SitlPlan) -> str:
    """Name what is faulty in a flight, such as ``gyro_bias``; the autopilot's own by component or kind."""
    faults = describe_faults(plan)
    names = [re.sub("[^A-Za-z0-9]+", "_", f"{each['component']} {each['kind']}".strip()) for each in faults]
    return "_and_".join(dict.fromkeys(names))[:LONGEST].strip("_") or "healthy"


def flights_of_file(
    path: Path,
    autopilot: str,
    scheme: str,
    catalogue: bool,
    flights: int | None,
    seed: str,
    assignments: Sequence[str],
) -> tuple[list[SitlPlan], dict[str, Mapping[str, object]] | None]:
    """Build what is to be flown of a scenario, its catalogue or a campaign.

    With it comes what was drawn for each flight of a campaign, by its name; None for one flight alone.
    """
    if "scenario" not in read_document(path).data:
        document = changed_document(path, [*assignments, *([f"seed={seed}"] if seed else [])])
        if catalogue:
            return plans_of_catalogue(document, scheme, flights, autopilot), {}
        return [plan_of(document, scheme, autopilot)], None
    if catalogue or scheme:
        raise ScenarioError(f"{path}: a campaign goes without --catalogue and --scheme, with its 'schemes'")
    if seed and not seed.isdecimal():
        raise ScenarioError(f"--seed {seed}: expected a whole number")
    found = campaign_flights(path, autopilot, flights, int(seed) if seed else None, assignments)
    return [each.plan for each in found], {each.plan.name: each.drawn for each in found}
