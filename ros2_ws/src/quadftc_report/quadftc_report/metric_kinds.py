"""What each metric of a summary is: its section of the table, its label, its unit, whether less is better."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, cast

import yaml

from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.metrics import Json, entries
from quadftc_model.samples import AXES
from quadftc_report import DATA
from quadftc_report.wording import period, plain

SETTLING = "fault_estimate_settling_s"
# how the sections of single faults and kinds of faults begin
DETAILS = ("Fault window", "Diagnosis of", "Naming of")
TINY = 1e-12  # in any unit; a smaller number is the rounding of a zero
SCALES = {"%": 100.0, "ms": 1e3}  # of units that are not those of the summary


class Kind(NamedTuple):
    """A metric."""

    label: str
    unit: str = ""
    less_is_better: bool = False

    @property
    def heading(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def text(self, value: float) -> str:
        """Write a number of a summary as the page does."""
        return plain(SCALES.get(self.unit, 1.0) * value) if abs(value) >= TINY else "0"


ROTORS = "Which rotor is named"  # section
_ROWS = yaml.safe_load((DATA / "metrics.yaml").read_text("utf-8"))
SECTIONS: dict[str, dict[str, Kind]] = {
    title: {name: Kind(*row) for name, row in rows.items()} for title, rows in _ROWS.items()
}
_KINDS = {
    name: (section, kind)
    for section, kinds in SECTIONS.items()
    for name, kind in kinds.items()
    if section != ROTORS  # whose names are those of sensors
}
# of a window, of a fault; and what has a table of its own
_NOT_METRICS = ("start", "stop", "axes", "axis", "kind", "component", "confusion_s")


class Leaf(NamedTuple):
    """A number of a summary, or one for each axis."""

    path: str  # without the axis
    has_axes: bool
    section: str
    kind: Kind


def list_metrics(metrics: Json, prefix: str = "", title: str = "") -> Iterator[Leaf]:
    """Yield every number of a summary; ``title``: of the fault window or fault whose numbers these are."""
    for name, value in entries(metrics):
        if name in _NOT_METRICS:
            continue
        if isinstance(value, (dict, list)):
            yield from list_metrics(value, f"{prefix}{name}.", title or _title(value, prefix, name))
        else:
            path = prefix.removesuffix(".") if name in AXES else f"{prefix}{name}"
            section, kind = describe(path)
            yield Leaf(path, name in AXES, title or section, kind)


def _title(value: Json, prefix: str, name: str) -> str:
    """The section of one fault window or one fault; empty: it is neither."""
    if prefix not in ("fault_windows.", "diagnosis.events.", "sensors.events.", "rotors.events."):
        return ""
    entry = cast("Metrics", value)
    when = period(entry["start"], entry["stop"])
    if prefix == "fault_windows.":
        return f"Fault window {int(name) + 1}, from {when}"
    if prefix == "rotors.events.":
        return f"Naming of the rotor: {entry['kind']} of rotor {entry['axis']}, from {when}"
    if prefix == "sensors.events.":
        return f"Naming of the sensor: {entry['component']} {entry['kind']} on {entry['axis']}, from {when}"
    return f"Diagnosis of the {entry['kind']} on {entry['axis']}, from {when}"


def describe(path: str) -> tuple[str, Kind]:
    """Return section and kind of the metric at a path; an unknown one has its own name as its label."""
    part, *words = path.split(".")
    if part == "sensors":
        return _describe_naming(words)
    if part == "rotors":
        name = words[2] if words[0] == "events" else words[0]
        return ROTORS, SECTIONS[ROTORS].get(name) or _look_up(name)[1]
    if part != "diagnosis":
        return _look_up(words[1] if part == "fault_windows" else part)
    if words[0] == "events":
        return _look_up(words[2])
    full, *rest = words
    section, kind = _look_up(full.removeprefix("total_"))
    if full.startswith("total_"):
        kind = kind._replace(label=f"{kind.label}, all axes")
    faults = [word for word in rest if word != "all"]  # by kind
    return f"Diagnosis of faults by kind: {faults[0]}" if faults else section, kind


def _describe_naming(words: list[str]) -> tuple[str, Kind]:
    """Section and kind of a metric of which sensor is named: of a fault, of a sensor, or of all."""
    if words[0] == "events":
        return _look_up(words[2])
    _, kind = _look_up(words[0])
    sensor = [word for word in words[1:] if word != "all"]
    return "Which sensor is named", kind._replace(label=": ".join([*sensor, kind.label]))


def _look_up(name: str) -> tuple[str, Kind]:
    suffix, unit = next(((f"_{unit}", unit) for unit in ("deg", "s") if name.endswith(f"_{unit}")), ("", ""))
    return _KINDS.get(name) or ("Other", Kind(name.removesuffix(suffix).replace("_", " "), unit))
