"""The summary of a run, as `summary.json` holds it, its checks, and the comparison with a stored one."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from quadftc_flight.checks import check_results
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow
from quadftc_flight.flight import Flight
from quadftc_flight.metrics import Json, entries, flight_metrics
from quadftc_flight.scenario import ROLES, Scenario, Scheme

ROUNDING = 1e-6  # relative; the same metrics on another processor differ by less
SHOWN = 3  # disagreements named in a warning

NO_OBSERVER = "none"  # kind of an observer that takes its sensor as it is
ATTITUDE_ERRORS = ("attitude_error_max_deg", "attitude_error_rms_deg")

_TIMING = ("wall_time_s", "real_time_factor")  # entries that a bag cannot tell


# of the attitude; of each axis of each sensor; of each rotor
Truth = tuple[Sequence[FaultWindow], Sequence[FaultEvent], Sequence[FaultEvent]]
Summary = dict[str, Any]  # of a flight as a whole, as its JSON file holds it


class StoredSummary(NamedTuple):
    """The summary beside a bag."""

    data: Summary  # empty if there is none
    problem: str  # what is wrong with the file, if anything


def summary(
    flight: Flight, scenario: Scenario, scheme: Scheme, wall_time: float | None, truth: Truth | None = None
) -> Summary:
    """Summarise a flight that took ``wall_time`` [s], ready for JSON; the caller adds versions and paths.

    ``truth`` is when which sensor and which rotor was faulty, if the scenario does not say it.
    """
    truth = truth or (scenario.fault_windows, scenario.fault_events, scenario.rotor_events)
    metrics = flight_metrics(flight, *truth)
    checks = check_results(metrics, scheme.checks)
    return {
        "name": scenario.name,
        "scheme": scheme.name,
        **{role: getattr(scheme, role).kind for role in ROLES},
        **{key: getattr(scenario, key) for key in ("vehicle", "rate", "duration", "seed")},
        "samples": len(flight),
        "samples_withheld": int((~flight.delivered).sum()),
        "wall_time_s": wall_time,
        "real_time_factor": scenario.duration / wall_time if wall_time else None,
        "metrics": metrics,
        "checks": [check._asdict() for check in checks],
        "passed": all(check.passed for check in checks),
    }


def relate_to_undiagnosed(summaries: Sequence[Summary]) -> list[Summary]:
    """Relate the attitude errors of runs to those without a diagnosis; return the summaries that got more.

    It adds ``without_diagnosis``: a scheme of the same scenario, disturbance observer and controller with the
    observer ``none``, and the errors over those of it. Above 1 is worse than without.
    """
    alike = ("name", "seed", "rate", "duration", "vehicle", "disturbance_observer", "controller")
    plain = {tuple(each[key] for key in alike): each for each in summaries if each["observer"] == NO_OBSERVER}
    related: list[Summary] = []
    for each in summaries:
        other = plain.get(tuple(each[key] for key in alike))
        if other is None or other is each:
            continue
        ratios = {f"{name}_ratio": _ratio(each, other, name) for name in ATTITUDE_ERRORS}
        each["without_diagnosis"] = {"scheme": other["scheme"], **ratios}
        related.append(each)
    return related


def _ratio(one: Summary, other: Summary, name: str) -> float | None:
    """Return a metric of one run over that of another; None where there is none."""
    part, whole = (each["metrics"][name] for each in (one, other))
    return part / whole if part is not None and whole else None


def partial_summary(flight: Flight, scenario: Scenario, scheme: Scheme, stored: Summary) -> Summary:
    """Summarise what was recorded of a flight; the checks, made for all of it, do not count."""
    unchecked = scheme.model_copy(update={"checks": ()})
    origin = {key: stored[key] for key in ("mode", "graph") if isinstance(stored.get(key), str)}
    return {**origin, **summary(flight, scenario, unchecked, None), "passed": None}


def read_summary(file: Path) -> StoredSummary:
    """Read the summary beside a bag."""
    problem = "no mapping" if file.is_file() else "missing"
    try:
        data: Json = file.is_file() and json.loads(file.read_text("utf-8"), parse_constant=_refuse_constant)
        if isinstance(data, dict):
            return StoredSummary(data, "")
    except (OSError, ValueError, RecursionError) as error:
        problem = f"broken ({type(error).__name__})"
    return StoredSummary({}, f"{file}: {problem}; computed from the bag")


def compare_summaries(computed: Summary, stored: StoredSummary, path: Path) -> tuple[Summary, list[str]]:
    """Return the summary of a whole recording, the bag at ``path``, and warnings.

    What lies beside the bag has entries of its own, and counts where it agrees with what was computed.
    """
    if not stored.data:
        return computed, [stored.problem] * bool(stored.problem)
    wrong = [
        place
        for key, value in computed.items()
        if key not in _TIMING
        for place in _differences(stored.data.get(key), value, key)
    ]
    if not wrong:
        return dict(stored.data), []
    more = f" and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
    places = ", ".join(wrong[:SHOWN]) + more
    timing = {key: stored.data[key] for key in _TIMING if isinstance(stored.data.get(key), (int, float))}
    warning = f"{path}: summary.json disagrees with the bag, whose numbers count: {places}"
    return {**stored.data, **computed, **timing}, [warning]


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not finite")


def _differences(stored: Json, computed: Json, place: str) -> Iterator[str]:
    """Yield the dotted paths at which two summaries differ by more than rounding."""
    ours, theirs = dict(entries(computed)), dict(entries(stored))
    is_same_kind = type(stored) is type(computed)
    if is_same_kind and (isinstance(computed, dict) or (ours and len(ours) == len(theirs))):
        for key, value in ours.items():
            yield from _differences(theirs.get(key), value, f"{place}.{key}")
    elif isinstance(computed, float) and isinstance(stored, (int, float)):
        with suppress(OverflowError):  # an int may be beyond all floats
            if math.isclose(stored, computed, rel_tol=ROUNDING, abs_tol=1e-9):
                return
        yield place
    elif stored != computed:
        yield place
