"""Captions of figures: what is shown, of how many flights or faults, and what is left out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from quadftc_report.campaign.detector import Detector
from quadftc_report.campaign.ecdf import Ecdf
from quadftc_report.campaign.heat_map import FEWEST, Maps
from quadftc_report.campaign.results import Results, Side, counts_text, numbers, titles
from quadftc_report.wording import counted, listing, plain, sentence


def spread(what: str, thing: str, curves: Sequence[tuple[Side, Ecdf]], zeros: bool) -> str:
    """Caption of distributions of ``what``, of which there is one value of each ``thing``.

    Parameters
    ----------
    zeros : bool
        Whether zeros are drawn at the left end, on a logarithmic scale.
    """
    counts = counts_text({side.name: curve.total for side, curve in curves}, thing)
    left = " Values of zero stand at the left end." if zeros else ""
    return f"Share of the {thing}s whose {what} is at most so much; {counts}.{left}"


def unfinished(sides: Sequence[Side]) -> str:
    """What the curves say of flights that did not stay finite."""
    counts = {side: int(np.sum(np.isinf(side.worst_tracking))) for side in sides}
    told = [f"{count} of {side.title}" for side, count in counts.items() if count]
    if not told:
        return ""
    return f"Flights that did not stay finite count as worse than all others: {listing(told)}."


def unobserved(results: Results, error_is_the_fault: bool) -> str:
    """What the figure makes of variants without fault observer."""
    without = results.without_observer
    if not without:
        return ""
    several = len(without) > 1
    if error_is_the_fault:
        so = f", so that {'their' if several else 'its'} error is the fault itself"
    else:
        so = f" and {'are' if several else 'is'} left out"
    return f"{titles(without)} {'have' if several else 'has'} no fault observer{so}."


def missed(sides: Sequence[Side]) -> str:
    """Why curves of the delay end below 1."""
    told: list[str] = []
    for side in sides:
        count = int(np.sum(np.isinf(side.detection_delays)))
        before = int(np.nansum(numbers(side.faults, "fault.already_declared")))
        early = f" ({before} of them as the axis was declared faulty before the onset)" if before else ""
        if count:
            told.append(f"{counted(count, 'fault')} of {side.title}{early}")
    return f"Without a delay, so that the curve ends below 100 %: {listing(told)}." if told else ""


def roc(results: Results, shown: Sequence[tuple[Side, Detector]]) -> Iterator[str]:
    """Sentences on the curves of the detectors."""
    counts = [f"{counted(each.faults, 'fault')} and {each.healthy} healthy axes" for _, each in shown]
    if len(set(counts)) == 1:
        many = f"{counts[0]}{' of each variant' if len(shown) > 1 else ''}"
    else:
        many = listing([f"{text} of {side.title}" for text, (side, _) in zip(counts, shown, strict=True)])
    yield (
        "If an estimate of some size were an alarm: the share of the faults that it finds, over the share"
        f" of the healthy axes to which it gives a false alarm, for every size; {many}. Each fault, and each"
        " axis of a flight, counts once, by the largest estimate while it is faulty, or healthy: these are no"
        " shares of time, and an axis that is healthy for longer has more time for a false alarm."
    )
    yield "AUC: area under the curve; 1: some size makes no mistake, 0.5 (dotted): guessing."
    silent = [f"{plain(100.0 * each.silent)} % of {side.title}" for side, each in shown if each.silent > 0.0]
    if silent:
        yield f"Of these largest estimates {listing(silent)} are zero, and no size tells those apart."
    if any(each.point is not None for _, each in shown):
        yield (
            "Dots, in the colours of the curves: the observers' own detectors; found is a fault that is"
            " declared while it lasts, a false alarm an axis that is declared faulty while it is healthy."
        )
    without = [side for side in results.sides if all(side is not other for other, _ in shown)]
    if without:
        verb = "has" if len(without) == 1 else "have"
        yield f"{titles(without)} {verb} no curve: no estimate above zero."


def heat_map(maps: Maps) -> str:
    """Caption of the maps."""
    of = "all faults of the flights in a cell" if maps.of_faults else "the flights in a cell"
    axis = ", worst axis" if maps.worst_axis else ""
    unit = f" [{maps.kind.unit}]" if maps.kind.unit else ""
    rows = {name: each.rows for name, each in maps.cells.items()}
    counts = counts_text(rows, "fault" if maps.of_faults else "flight")
    same = ", in the same colours for every variant" if len(maps.cells) > 1 else ""
    parts = " A range is divided into parts with as many flights each." if maps.divided else ""
    return sentence(
        f"median of the {maps.kind.label}{axis}{unit} of {of}{same}; {counts}. Cells with fewer than {FEWEST}"
        f" flights are grey.{parts}".rstrip(".")
    )
