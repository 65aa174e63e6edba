"""Numbers of a run: from its summary by their path, and from its flight where the summary has none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.flight import Flight
from quadftc_flight.metrics import look_up
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded

Floats = NDArray[np.float64]
Values = dict[str, float | None]  # by axis


def metric(run: Recorded, path: str) -> Any:
    """Return what is at a dotted path in ``summary["metrics"]``, or None."""
    try:
        return look_up(run.summary["metrics"], path)
    except KeyError:
        return None


def axis_metric(run: Recorded, path: str) -> Values:
    """Return the metric of each axis at a dotted path; None where there is none."""
    found = metric(run, path)
    values = cast("dict[str, Any]", found) if isinstance(found, dict) else {}
    return {axis: values.get(axis) for axis in AXES}


def tracking_error_deg(flight: Flight) -> Floats:
    """True attitude less reference [deg] (n, 3), wrapped."""
    return np.degrees(np.asarray(wrap(flight.angles - flight.reference)))


def rms_between(flight: Flight, columns: Floats, start: float, stop: float) -> Values:
    """Root mean square of the columns (n, 3) of a flight from ``start`` to ``stop`` [s]; None: not known."""
    return _over(flight, columns, start, stop, _rms)


def mean_between(flight: Flight, columns: Floats, start: float, stop: float) -> Values:
    """Mean of the columns (n, 3) of a flight from ``start`` to ``stop`` [s]; None: not known."""
    return _over(flight, columns, start, stop, np.mean)


def deviation_between(flight: Flight, columns: Floats, start: float, stop: float) -> Values:
    """Standard deviation of the columns (n, 3) of a flight from ``start`` to ``stop`` [s]."""
    return _over(flight, columns, start, stop, np.std)


def ratios(over: Values, under: Values) -> Values:
    """Divide axis by axis; None where a value is missing or the divisor is zero."""
    result: Values = {}
    for axis in AXES:
        above, below = over.get(axis), under.get(axis)
        result[axis] = above / below if above is not None and below else None
    return result


def percent(values: Values) -> Values:
    """Turn shares into percent."""
    return {axis: None if value is None else 100.0 * value for axis, value in values.items()}


def complete(values: Values) -> dict[str, float] | None:
    """Return the values if every axis has one."""
    known = {axis: value for axis, value in values.items() if value is not None}
    return known if len(known) == len(AXES) else None


def _rms(values: Floats) -> np.float64:
    return np.sqrt(np.mean(values**2))


def _over(
    flight: Flight, columns: Floats, start: float, stop: float, measure: Callable[[Floats], np.floating[Any]]
) -> Values:
    rows = columns[(flight.time >= start) & (flight.time < stop)]
    result: Values = {}
    for index, axis in enumerate(AXES):
        known = rows[np.isfinite(rows[:, index]), index]
        result[axis] = float(measure(known)) if len(known) else None
    return result
