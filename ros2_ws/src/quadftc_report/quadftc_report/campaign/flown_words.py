"""What was flown, in words."""

from __future__ import annotations

import re
from typing import Any

from quadftc_campaign.distributions import Distribution, unit_of
from quadftc_report.campaign.results import Results, Side
from quadftc_report.page_tables import Fact
from quadftc_report.wording import listing, plain

_LONG_NUMBER = re.compile(r"[-+]?\d+\.\d{4,}(?:[eE][-+]?\d+)?")
_KINDS = {
    "uniform": "uniform, {low} to {high}",
    "log_uniform": "uniform in the logarithm, {low} to {high}",
    "normal": "normal, mean {low}, standard deviation {high}",
}


def flown(results: Results) -> list[tuple[str, list[Fact]]]:
    """Return the facts of a campaign, by heading."""
    campaign = results.campaign
    data, base = campaign.document.data, campaign.base.data
    fixed: list[str] = [str(each) for each in data.get("set", [])]
    facts = {
        "scenario": " with ".join(filter(None, [str(data.get("scenario", "")), listing(fixed)])),
        "duration of a flight": str(base.get("duration", "")),
        "flights": f"{campaign.flights} of each variant, the same draws for all",
        "seed": str(campaign.seed),
        "precision": "float32" if campaign.float32 else "float64",
    }
    return [
        ("Campaign", [Fact(name, (text,)) for name, text in facts.items() if text]),
        ("Variants", [Fact(side.name, (parts_text(side),)) for side in results.sides]),
        (
            "Drawn for each flight",
            [Fact(path, (in_words(drawn),)) for path, drawn in campaign.vary.items()]
            + [Fact("seed", ("of noise and the like, a new one for each flight",))],
        ),
    ]


def parts_text(side: Side) -> str:
    """Write what a variant is made of."""
    names = {
        "observer": "fault observer",
        "disturbance_observer": "disturbance observer",
        "controller": "controller",
    }
    there = {words: side.rows[key].drop_nulls() for key, words in names.items() if key in side.rows.columns}
    return ", ".join(f"{words} {column[0]}" for words, column in there.items() if len(column))


def in_words(drawn: Distribution) -> str:
    """Write how a value is drawn, such as ``uniform, 0.5 deg to 5 deg, of either sign``."""
    if drawn.values:
        values = [value_text(value) for value in drawn.values]
        if len(values) == 1:
            text = values[0]
        elif drawn.is_grid:
            text = f"each in turn: {listing(values)}"
        else:
            text = f"{listing(values, 'or')}, each as likely"
    else:
        low, high = (f"{plain(bound)} {drawn.unit}".rstrip() for bound in drawn.bounds)
        text = _KINDS[drawn.kind].format(low=low, high=high)
    signed = ", of either sign" if drawn.signed else ""
    several = f"; {drawn.size} of them" if drawn.size else ""
    return f"{text}{signed}{several}"


def unit(drawn: Distribution) -> str:
    """Unit of a value in the table; empty: it has none, or not always the same."""
    if not drawn.values:
        return "" if drawn.size else drawn.unit
    units = {unit_of(value) for value in drawn.values}
    return units.pop() if len(units) == 1 and not drawn.size else ""


def value_text(value: Any) -> str:
    """Write a value as it was drawn; long numbers with three digits."""
    if isinstance(value, float):
        return plain(value)
    return _LONG_NUMBER.sub(lambda match: plain(float(match[0])), str(value))
