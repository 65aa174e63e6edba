"""What came out, in a few sentences written from the numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from quadftc_report.campaign.campaign_tables import alarms_per_hour, healthy_hours
from quadftc_report.campaign.results import Results, Side, known, numbers, titles
from quadftc_report.wording import counted, duration, listing, plain, quantity, sentence

TOLD = 3  # variants that are told one by one; of more, the best and the worst


def result_sentences(results: Results) -> list[str]:
    """Return what the result of a campaign is, in plain sentences."""
    tracking = " ".join(filter(None, [_tracking(results), _better(results)]))
    return [text for text in (*_broken(results), tracking, _faults(results)) if text]


def _broken(results: Results) -> Iterator[str]:
    counts = [(side.summary["not_finite"], side) for side in results.sides if side.summary["not_finite"]]
    if not counts:
        return
    flights = sum(side.summary["flights"] for side in results.sides)
    if len(counts) > TOLD:
        who = f"{sum(count for count, _ in counts)} of {counted(flights, 'flight')} of all variants"
    else:
        totals = [(count, counted(side.summary["flights"], "flight"), side.title) for count, side in counts]
        who = listing([f"{count} of {total} of {title}" for count, total, title in totals])
    yield f"{who} did NOT stay finite; what numbers they lack is in no quantile."


def _tracking(results: Results) -> str:
    sides = [side for side in results.sides if len(known(side.worst_tracking))]
    if not sides:
        return ""
    ordered = sorted(sides, key=_middle)
    told = sides if len(sides) <= TOLD else [ordered[0], ordered[-1]]
    texts = [_spread(side, len(results.sides) > 1) for side in told]
    among = f"; of {len(sides)} variants these are the best and the worst" if told is not sides else ""
    what = "the worst axis of the median flight is tracked with an RMSE of"
    return sentence(f"{what} {listing(texts)}{among}")


def _spread(side: Side, named: bool) -> str:
    values = known(side.worst_tracking)
    high = quantity(float(np.quantile(values, 0.95)), "deg")
    who = f" by {side.title}" if named else ""
    return f"{quantity(float(np.median(values)), 'deg')}{who} (at most {high} in 95 % of the flights)"


def _middle(side: Side) -> float:
    return float(np.median(known(side.worst_tracking)))


def _better(results: Results) -> str:
    """In how many flights the best is better than the others, flight by flight."""
    sides = [side for side in results.sides if len(known(side.worst_tracking))]
    if len(sides) < 2 or any(len(side.worst_tracking) != len(sides[0].worst_tracking) for side in sides):
        return ""
    best = min(sides, key=_middle)
    others = [side for side in sides if side is not best]
    rest = np.min([_in_order(side) for side in others], axis=0)
    wins = int(np.sum(_in_order(best) < rest))
    than = others[0].title if len(others) == 1 else "every other variant"
    return sentence(f"{best.title} tracks better than {than} in {wins} of {counted(len(rest), 'flight')}")


def _in_order(side: Side) -> np.ndarray:
    return side.worst_tracking[np.argsort(side.flights["flight"].to_numpy(), kind="stable")]


def _faults(results: Results) -> str:
    if not results.kinds:
        return "No flight had a sensor fault."
    sides = [side for side in results.with_observer if _judged(side)]
    ordered = sorted(sides, key=lambda side: -_found(side) / _judged(side))
    told: Sequence[Side] = sides if len(sides) <= TOLD else [ordered[0], ordered[-1]]
    texts = [_found_text(side) for side in told]
    if len(told) < len(sides):
        texts.append(f"of {len(sides)} variants these find most and fewest")
    without = results.without_observer
    if without:
        texts.append(f"{titles(without)} {'has' if len(without) == 1 else 'have'} no fault observer")
    return sentence("; ".join(texts))


def _found_text(side: Side) -> str:
    found = _found(side)
    text = f"{side.title} finds {found} of {counted(_judged(side), 'fault')}"
    delays = known(numbers(side.faults, "fault.detection_delay_s"))
    if len(delays):
        text += f", the median one after {duration(float(np.median(delays)))}"
    rate = alarms_per_hour(side)
    if rate is None:
        return text
    hours = f"{plain(healthy_hours(side))} h of healthy axes"
    alarms = "no false alarm" if rate == 0.0 else f"{plain(rate)} false alarms an hour"
    return f"{text}, with {alarms} in {hours}"


def _judged(side: Side) -> int:
    return int(np.sum(~np.isnan(numbers(side.faults, "fault.detected"))))


def _found(side: Side) -> int:
    return int(np.nansum(numbers(side.faults, "fault.detected")))
