"""The report of many flights: each fault, what is faulty against what is named, sizes that kill.

Flights are named after their fault in the catalogue, and their seed; those of a campaign after what is
faulty, and their number.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from quadftc_flight.summary import Summary
from quadftc_sitl.scoring import EARLY, Told, kind_of

COLUMNS = ("fault", "flights", "autopilot", "observer", "diagnose", "survived")
BINS, FEWEST = 4, 8  # parts of the sizes of a fault; flights of a fault whose sizes are divided
MOST = 8  # different texts of a drawn value that are told
NOTHING = "nothing"
SOURCES = ("autopilot", "observer", "diagnose")

Flights = Sequence[Summary]
Drawn = Mapping[str, Mapping[str, object]]  # values by the name of a flight and their path
Row = tuple[str, ...]


def markdown(summaries: Flights, drawn: Drawn | None = None) -> str:
    """Write the report for a document; ``drawn`` has the values of each flight by its name, if any were."""
    flown = [each for each in summaries if "error" not in each]
    parts = [_table([COLUMNS, *table_rows(flown)])]
    for source in SOURCES:
        heading = f"First said by {'the ' * (source != 'diagnose')}{source}, by what is faulty"
        parts.append(f"{heading}:\n\n{_table(confusion_rows(flown, source))}")
    parts.append(f"What kills, by size:\n\n{_table(map_rows(flown))}")
    if drawn:
        parts.append(f"What kills, by what was drawn:\n\n{_table(drawn_rows(flown, drawn))}")
    return "\n".join(parts)


def table_rows(summaries: Flights) -> Iterator[Row]:
    """Return a row of `COLUMNS` for each fault of a catalogue."""
    for name, flights in _by_fault(summaries).items():
        survived = sum(flight["survived"] for flight in flights)
        cells = [_share(flights, source) for source in SOURCES]
        yield name, str(len(flights)), *cells, f"{survived} of {len(flights)}"


def confusion_rows(flights: Flights, source: str) -> list[Row]:
    """Return a matrix with its heading: what is faulty, by what a source said first, in how many flights."""
    counts: dict[str, dict[str, int]] = {}
    for flight in flights:
        faults = flight["faults"]
        if source == "observer" and any(fault["source"] == "autopilot" for fault in faults):
            continue  # it is not in what the observer sees
        row = counts.setdefault(_truth(faults), {})
        said = _first_said(flight, source)
        row[said] = row.get(said, 0) + 1
    columns = sorted(
        {said for row in counts.values() for said in row}, key=lambda said: (said != NOTHING, said)
    )
    rows = [(true, *(str(row.get(said, "")) for said in columns)) for true, row in counts.items()]
    return [("faulty", *columns), *rows]


def map_rows(flights: Flights) -> list[Row]:
    """Return, with a heading, how many flights of each fault were lost, by the size of the fault."""
    rows: list[Row] = [("fault", "size", "lost")]
    for name, group in _by_fault(flights).items():
        known = [each for each in group if each["faults"] and each["faults"][0]["size"] is not None]
        if not known:
            rows.append((name, "-", f"{sum(not each['survived'] for each in group)} of {len(group)}"))
            continue
        sizes = [abs(each["faults"][0]["size"]) for each in known]
        rows += ((name, *cells) for cells in _lost_by_size(sizes, [not each["survived"] for each in known]))
    return rows


def drawn_rows(flights: Flights, drawn: Drawn) -> list[Row]:
    """Return, with a heading, how many flights were lost by each value that varies.

    Numbers are divided as sizes are; of texts, those with few different ones are told.
    """
    rows: list[Row] = [("drawn", "value", "lost")]
    for path in dict.fromkeys(path for each in flights for path in drawn[each["name"]]):
        here = [each for each in flights if path in drawn[each["name"]]]
        values = [drawn[each["name"]][path] for each in here]
        lost = [not each["survived"] for each in here]
        numbers = [value for value in values if isinstance(value, float)]
        if len(numbers) == len(values):
            rows += ((path, *cells) for cells in _lost_by_size(numbers, lost))
            continue
        words = sorted({*map(str, values)})
        for word in words if len(words) <= MOST else ():
            gone = [each for each, value in zip(lost, values, strict=True) if str(value) == word]
            rows.append((path, word, f"{sum(gone)} of {len(gone)}"))
    return rows


def _lost_by_size(values: Sequence[float], gone: Sequence[bool]) -> Iterator[tuple[str, str]]:
    """Return spans with about as many values in each, and how many flights were lost of each."""
    sizes, lost = np.array(values), np.array(gone)
    count = BINS if len(sizes) >= FEWEST else 1
    edges = np.quantile(sizes, np.linspace(0.0, 1.0, count + 1))
    bins = np.clip(np.searchsorted(edges, sizes, side="right") - 1, 0, count - 1)
    for number, (low, high) in enumerate(itertools.pairwise(edges.tolist())):
        if here := int(np.sum(bins == number)):
            span = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
            yield span, f"{int(lost[bins == number].sum())} of {here}"


def _by_fault(summaries: Flights) -> dict[str, list[Summary]]:
    """Return the flights that were flown, by the name of their fault."""
    groups: dict[str, list[Summary]] = {}
    for each in summaries:
        if "error" not in each:
            groups.setdefault(each["name"].rpartition("-")[0] or each["name"], []).append(each)
    return groups


def _truth(faults: Sequence[Told]) -> str:
    """Say what is faulty; a fault of the autopilot's own simulation is in one of its sensors."""
    names = [each["component"] + " (its own)" * (each["source"] == "autopilot") for each in faults]
    return " and ".join(dict.fromkeys(names)) or NOTHING


def _first_said(flight: Summary, source: str) -> str:
    """Return what a source said first since the first fault: a component, several if in doubt, or nothing."""
    faults = flight["faults"]
    start = min((fault["start"] for fault in faults), default=0.0)
    if source == "autopilot":
        events = (event for event in flight["autopilot_said"] if event["serious"] and event["time"] >= start)
        return next((event["kind"] for event in events), NOTHING)
    said = flight["observer_said"] if source == "observer" else flight["diagnose"]["findings"]
    key = "time" if source == "observer" else "onset"
    later = [each for each in said if each[key] >= start - EARLY * bool(faults)]
    if not later:
        return NOTHING
    first = min(later, key=lambda each: each[key])
    names = (first["component"], *(each.partition("/")[0] for each in first["ambiguous_with"]))
    return " or ".join(sorted({*map(kind_of, names)}))


def _share(flights: Flights, source: str) -> str:
    """Say in how many flights a source told of the fault, and when; of healthy ones, in how many of any."""
    word = "noticed" if source == "autopilot" else "named"
    faults = [fault[source] for flight in flights for fault in flight["faults"]]
    if not faults:
        false = sum(flight["metrics"][f"{source}_false"] > 0 for flight in flights)
        return f"{false} false"
    told = [each for each in faults if each[word]]
    if all(each[word] is None for each in faults):
        return "-"
    delays = [each["delay_s"] for each in told]
    after = f", {statistics.median(delays):.2g} s" if delays else ""
    return f"{len(told)} of {len(faults)}{after}"


def _table(rows: Iterable[Row]) -> str:
    """Write rows, the first the heading, as a table of Markdown."""
    heading, *others = rows
    lines = [heading, ("---",) * len(heading), *others]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
