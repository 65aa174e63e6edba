"""The summary beside a bag, and whether it says what the flight itself says."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from quadftc_flight.flight import Flight
from quadftc_flight.scenario import Scenario, Scheme
from quadftc_flight.summary import summary

ROUNDING = 1e-6  # relative; the same metrics on another processor differ by less
SHOWN = 3  # disagreements named in a warning

_TIMING = ("wall_time_s", "real_time_factor")  # entries that a bag cannot tell


def read_summary(file: Path) -> tuple[dict[str, Any], str]:
    """Read a summary; return it and no text, or nothing and what is wrong with the file."""
    if not file.is_file():
        return {}, f"{file}: missing; computed from the bag"
    try:
        data: Any = json.loads(file.read_text("utf-8"), parse_constant=_no_number)
    except (OSError, ValueError, RecursionError) as error:
        return {}, f"{file}: broken ({type(error).__name__}); computed from the bag"
    if not isinstance(data, dict):
        return {}, f"{file}: no mapping; computed from the bag"
    return cast("dict[str, Any]", data), ""


def whole_summary(computed: dict[str, Any], stored: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Return the summary of a whole recording, and where the stored one does not agree with it.

    Parameters
    ----------
    computed : dict
        From the bag; counts where they differ.
    stored : mapping
        What lies beside the bag; counts where they agree, and has entries of its own. May be empty.
    """
    if not stored:
        return computed, ""
    wrong = [
        place
        for key, value in computed.items()
        if key not in _TIMING
        for place in _differences(stored.get(key), value, key)
    ]
    if not wrong:
        return dict(stored), ""
    more = f" and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
    timing = {key: stored[key] for key in _TIMING if isinstance(stored.get(key), (int, float))}
    return {**stored, **computed, **timing}, ", ".join(wrong[:SHOWN]) + more


def partial_summary(
    flight: Flight, scenario: Scenario, scheme: Scheme, stored: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the summary of what was recorded of a flight; the checks, made for all of it, do not count."""
    unchecked = dataclasses.replace(scheme, checks=())
    origin = {key: stored[key] for key in ("mode", "graph") if isinstance(stored.get(key), str)}
    return {**origin, **summary(flight, scenario, unchecked, None), "passed": None}


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number")


def _is_near(stored: float, computed: float) -> bool:
    """Whether two numbers differ by rounding only; an int may be beyond all floats."""
    try:
        return math.isclose(stored, computed, rel_tol=ROUNDING, abs_tol=1e-9)
    except OverflowError:
        return False


def _differences(stored: Any, computed: Any, place: str) -> Iterator[str]:
    """Yield the dotted paths at which two summaries differ by more than rounding."""
    if isinstance(computed, dict) and isinstance(stored, dict):
        there = cast("dict[str, Any]", stored)
        for key, value in cast("dict[str, Any]", computed).items():
            yield from _differences(there.get(key), value, f"{place}.{key}")
    elif isinstance(computed, list) and isinstance(stored, list):
        ours, theirs = cast("list[Any]", computed), cast("list[Any]", stored)
        if len(ours) == len(theirs):
            for index, (theirs_at, ours_at) in enumerate(zip(theirs, ours, strict=True)):
                yield from _differences(theirs_at, ours_at, f"{place}.{index}")
        else:
            yield place
    elif isinstance(computed, float) and isinstance(stored, (int, float)):
        if not _is_near(stored, computed):
            yield place
    elif stored != computed:
        yield place
