"""What the topic ``diagnosis`` said of each component, as columns of a flight.

A report holds until the next one, at most to the end of its `REPORT_PERIOD_NS`: it comes at once on a change.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.diagnosis import COMPONENTS, REPORT_PERIOD_NS, report_flight
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_model.arrays import AnyArray, alike, rows_of
from quadftc_model.samples import HEALTHY, ComponentFault, DiagnosisReport, FaultEstimate

if TYPE_CHECKING:
    from quadftc_bags.bag import Series
    from quadftc_flight.flight import Flight

# of an element that the observer does not watch, and of one that is healthy
UNWATCHED: dict[str, float | np.generic] = {
    "state": np.uint8(255),
    "estimate": np.nan,
    "std_dev": np.nan,
    "onset_ns": np.int64(0),
    "probability": np.nan,
    "ambiguous": np.False_,
}
WATCHED = {**UNWATCHED, "state": np.uint8(HEALTHY), "estimate": 0.0, "std_dev": -1.0, "probability": 0.0}


class ReportLog:
    """The reports that are due on the estimates of a flight, which come in stretches."""

    def __init__(self, law: FaultObserver) -> None:
        self.reports: list[DiagnosisReport] = []
        self._law = law
        self._last: tuple[NDArray[np.int64], FaultEstimate] | None = None  # stamp [ns] and estimate, (1, ...)

    def note(self, stamp_ns: NDArray[np.int64], estimates: FaultEstimate) -> None:
        """Note the estimates of further samples [ns], (n, ...)."""
        if not len(stamp_ns):
            return
        before = self._last
        # a copy, as what was flown may be changed by what is flown next
        self._last = joined([rows_of((stamp_ns, estimates), slice(-1, None))])
        if before is None:
            self.reports += report_flight(self._law, stamp_ns, estimates)
        else:
            self.reports += report_flight(self._law, *joined([before, (stamp_ns, estimates)]))[1:]


def joined(parts: Sequence[Any]) -> Any:
    """Return arrays of nested tuples alike, one behind the other."""
    first = parts[0]
    if isinstance(first, tuple):
        inside = [joined(each) for each in zip(*parts, strict=True)]
        return alike(cast("tuple[object, ...]", first), inside)
    return None if first is None else np.concatenate(parts)


def note_reports(flight: Flight, reports: Sequence[DiagnosisReport]) -> None:
    """Fill the columns ``<component>_<quantity>`` of a flight that the published reports tell of."""
    if not reports:
        return
    reports = sorted(reports, key=lambda report: report.stamp_ns)
    stamps = np.array([report.stamp_ns for report in reports], np.int64)
    latest = np.searchsorted(stamps, flight.stamp_ns, side="right") - 1
    held = flight.delivered & (latest >= 0)
    held &= stamps[latest] // REPORT_PERIOD_NS == flight.stamp_ns // REPORT_PERIOD_NS
    rotors = tuple(str(number + 1) for number in range(flight.rotor_state.shape[1]))
    elements = {**{name: names for name, (names, _) in COMPONENTS.items()}, "rotor": rotors}
    for component, names in elements.items():
        for quantity, said in _columns_of(component, names, reports).items():
            column = getattr(flight, f"{component}_{quantity}", None)
            # of a rotor every sample is on a topic of its own, but for the onset
            if column is not None and (component != "rotor" or quantity == "onset_ns"):
                column[held] = said[latest[held]]


def reports_from(series: Series) -> list[DiagnosisReport]:
    """Return the messages of the topic ``diagnosis``."""
    rows = zip(series.stamp_ns.tolist(), series["watched"], series["faults"], strict=True)
    return [report_of(*row) for row in rows]


def report_of(stamp_ns: int, watched: Iterable[str], faults: Iterable[Any]) -> DiagnosisReport:
    """Return a report by the fields of its message."""
    return DiagnosisReport(stamp_ns, tuple(watched), tuple(map(_fault_of, faults)))


def _fault_of(message: Any) -> ComponentFault:
    onset_ns = message.onset.sec * 1_000_000_000 + message.onset.nanosec
    values = {name: getattr(message, name) for name in ComponentFault._fields if name != "onset_ns"}
    values["ambiguous_with"] = tuple(message.ambiguous_with)
    return ComponentFault(**values, onset_ns=onset_ns)


def _columns_of(
    component: str, elements: Sequence[str], reports: Sequence[DiagnosisReport]
) -> dict[str, AnyArray]:
    """Return what each report says of the elements of a component, by quantity (n, elements)."""
    watched = np.array([component in report.watched for report in reports])[:, None]
    columns = {
        name: np.where(watched, WATCHED[name], UNWATCHED[name]).repeat(len(elements), 1) for name in WATCHED
    }
    for row, report in enumerate(reports):
        for fault in report.faults:
            if fault.component != component or fault.element not in elements:
                continue
            at = row, elements.index(fault.element)
            columns["state"][at], columns["onset_ns"][at] = fault.state, fault.onset_ns
            columns["estimate"][at], columns["std_dev"][at] = fault.size, fault.std_dev
            columns["probability"][at] = fault.probability
            columns["ambiguous"][at] = bool(fault.ambiguous_with)
    return columns
