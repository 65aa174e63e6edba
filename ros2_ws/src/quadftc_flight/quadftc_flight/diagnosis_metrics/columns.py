"""What a flight says of the diagnosis, as columns of three axes in degrees and seconds."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.flight import NO_STATE, Flight
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FAULTY, HEALTHY, RECOVERING, STARTING, SUSPECT
from quadftc_model.stepper import NANOSECONDS_PER_SECOND

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False)
class Columns:
    """Columns of a flight; NaN where a number is not known.

    An axis is *declared* faulty in the states FAULTY and RECOVERING, *trusted* in HEALTHY and SUSPECT, and
    neither in STARTING.
    """

    flight: Flight

    @property
    def time(self) -> Floats:
        """Scenario time [s] (n,)."""
        return self.flight.time

    @functools.cached_property
    def period(self) -> float:
        """The time that a row stands for: the median time between two [s]; NaN of less than two rows."""
        if len(self.time) < 2:
            return np.nan
        return float(np.median(np.diff(self.flight.stamp_ns))) / NANOSECONDS_PER_SECOND

    @functools.cached_property
    def known(self) -> Mask:
        """Whether there is a state (n, 3)."""
        return self.flight.fault_state != NO_STATE

    @functools.cached_property
    def declared(self) -> Mask:
        """Whether the axis is declared faulty (n, 3)."""
        return (self.flight.fault_state == FAULTY) | (self.flight.fault_state == RECOVERING)

    @functools.cached_property
    def trusted(self) -> Mask:
        """Whether the sensor is believed (n, 3)."""
        return (self.flight.fault_state == HEALTHY) | (self.flight.fault_state == SUSPECT)

    @property
    def starting_share(self) -> dict[str, float | None]:
        """Share of the samples of each axis in which the diagnosis has not begun yet."""
        starting = self.flight.fault_state == STARTING
        counts = zip(
            AXES, np.sum(starting, axis=0).tolist(), np.sum(self.known, axis=0).tolist(), strict=True
        )
        return {axis: part / whole if whole else None for axis, part, whole in counts}

    @functools.cached_property
    def fault(self) -> Floats:
        """True fault [deg] (n, 3)."""
        return np.degrees(self.flight.fault)

    @functools.cached_property
    def estimate(self) -> Floats:
        """Estimated fault [deg] (n, 3)."""
        return np.degrees(self.flight.fault_estimate)

    @functools.cached_property
    def error(self) -> Floats:
        """Estimated less true fault [deg] (n, 3), wrapped."""
        return np.degrees(wrap(self.flight.fault_estimate - self.flight.fault))

    @functools.cached_property
    def normalised(self) -> Floats:
        """Error over the standard deviation that the observer gives [1] (n, 3); NaN where it gives none."""
        std_dev = np.degrees(self.flight.fault_std_dev)
        given = std_dev > 0.0  # false for NaN, too
        return np.where(given, self.error / np.where(given, std_dev, 1.0), np.nan)

    @functools.cached_property
    def tracking(self) -> Floats:
        """True angle less reference [deg] (n, 3), wrapped."""
        return np.degrees(wrap(self.flight.angles - self.flight.reference))

    @functools.cached_property
    def onset(self) -> Floats:
        """When the present fault began, as the observer says [s] (n, 3); NaN: it says of none."""
        onset_ns = self.flight.fault_onset_ns
        first_ns = self.flight.stamp_ns[0] if len(self.time) else 0
        return np.where(onset_ns > 0, (onset_ns - first_ns) / NANOSECONDS_PER_SECOND, np.nan)

    def rows(self, start: float, stop: float) -> slice:
        """Return the rows with start <= time < stop."""
        first, last = np.searchsorted(self.time, (start, stop), side="left").tolist()
        return slice(first, max(first, last))
