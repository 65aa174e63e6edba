"""What tuning brought: flights not used for it, before and after; and the file of the gains."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray
from ruamel.yaml import YAML

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.tune.cost import Cost, values_of
from quadftc_campaign.tune.searched_gains import Gains
from quadftc_flight.scenario import ROLES, Scenario, grade_of
from quadftc_model.samples import AXES

Floats = NDArray[np.float64]


class Judged(NamedTuple):
    """Flights not used for tuning."""

    cost: float
    metrics: dict[str, float]  # means over flights and axes
    missed: int  # faults
    false_alarms: int
    crashed: int  # flights


def judged(frame: pl.DataFrame, cost: Cost) -> Judged:
    """Judge the flights of a campaign's table."""
    flights = frame.unique("flight", keep="first", maintain_order=True)
    rows = list(flights.iter_rows(named=True))
    values = np.array([values_of(row, cost.weights) for row in rows])
    detected = frame["fault.detected"] if "fault.detected" in frame.columns else pl.Series(dtype=pl.Boolean)
    alarms = sum(int(flights[f"false_alarms.{axis}"].sum()) for axis in AXES)
    means = np.nanmean(values, axis=(0, 2)) if rows else np.full(len(cost.weights), np.nan)
    return Judged(
        cost.of(values),
        dict(zip(cost.weights, map(float, means), strict=True)),
        int((~detected.drop_nulls()).sum()),
        alarms,
        int((~flights["finite"]).sum()),
    )


def gains_document(scenario: Scenario, scheme: str, gains: Gains) -> dict[str, Any]:
    """What the file of the gains holds: see `quadftc_flight.scenario.files`."""
    parts: dict[str, dict[str, Any]] = {}
    for name, value in gains.plain().items():
        role, _, parameter = name.partition(".")
        parts.setdefault(role, {"kind": getattr(scenario.scheme(scheme), role).kind})[parameter] = value
    vehicle = scenario.document.data["vehicle"]
    return {
        "vehicle": vehicle,
        "grade": grade_of(scenario.document),
        **{role: parts[role] for role in ROLES if role in parts},
    }


def write_gains(
    path: Path, campaign: Campaign, document: Mapping[str, Any], before: Judged, after: Judged, flights: int
) -> None:
    """Write the file of the gains, with how they were found and what they bring.

    Raises
    ------
    CampaignError
        If it cannot be written.
    """
    lines = [
        f"Gains for {document['vehicle']} with sensors of grade {document['grade']}, found by",
        "",
        f"  scripts/quadftc tune {campaign.document.source}",
        "",
        f"Means over {flights} flights not used for it, before and after:",
        *(f"  {name}: {before.metrics[name]:.4g} -> {after.metrics[name]:.4g}" for name in before.metrics),
        f"  cost: {before.cost:.4g} -> {after.cost:.4g}",
    ]
    yaml: Any = YAML()
    yaml.default_flow_style = None
    stream = io.StringIO()
    yaml.dump(dict(document), stream)
    text = "".join(f"# {line}".rstrip() + "\n" for line in lines) + "\n" + stream.getvalue()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CampaignError(f"{path}: {error.strerror}") from None
