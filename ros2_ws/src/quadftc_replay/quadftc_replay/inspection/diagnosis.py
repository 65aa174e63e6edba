"""`quadftc diagnose` without its screen: read a log, put faults on it, judge it, write what came out."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from pathlib import Path
from xml.etree import ElementTree as ET

from quadftc_flight.scenario import Fault
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.inspection.inspect import Inspection, Progress, inspect
from quadftc_replay.inspection.overlay import overlay_faults
from quadftc_replay.inspection.verdict import Verdict, show, unjudged
from quadftc_replay.overlay import faults_from
from quadftc_replay.readers import read_log

VERDICT = "verdict.json"
READING = 0.2  # share of the work


@dataclasses.dataclass(frozen=True, kw_only=True)
class DiagnosisOptions:
    """What to judge, and how."""

    baseline: Path | None = None  # healthy flight of the same vehicle
    faults: tuple[str, ...] = ()  # specifications of faults to overlay
    vehicle: str = ""  # name or TOML file, for the layout of the rotors; empty: what the log says
    seed: int = 0  # of random faults


def diagnose_log(
    path: Path, options: DiagnosisOptions, progress: Progress = lambda _share: None
) -> Inspection:
    """Read and judge a log; a ValueError of one line says what is wrong with it or with the options."""
    faults: tuple[Fault, ...] = faults_from((), options.faults)
    log = _with_layout(read_log(path), options.vehicle)
    baseline = None if options.baseline is None else _with_layout(read_log(options.baseline), options.vehicle)
    progress(READING)
    if faults:
        log = overlay_faults(log, faults, options.seed)
    result = inspect(log, baseline, lambda share: progress(READING + (1.0 - READING) * share))
    if not result.verdict.judged:
        raise ValueError(f"{path}: {result.verdict.sentence[0].lower()}{result.verdict.sentence[1:-1]}")
    return result


def _with_layout(log: FlightLog, vehicle: str) -> FlightLog:
    """Add where the rotors are, by a vehicle file."""
    name = vehicle or log.vehicle
    if not name or (log.rotor_positions is not None and not vehicle):
        return log
    rotors = load_vehicle(name).rotors
    return dataclasses.replace(
        log, vehicle=name, rotor_positions=rotors.positions, rotor_yaw_signs=rotors.yaw_sign
    )


def write_verdict(verdict: Verdict, directory: Path) -> Path:
    """Write ``verdict.json``; an earlier one is replaced when the new one is whole."""
    directory.mkdir(parents=True, exist_ok=True)
    return write_file(directory / VERDICT, verdict.model_dump_json(indent=2) + "\n")


def write_junit(verdict: Verdict, path: Path) -> Path:
    """Write the verdict as JUnit XML: one test case for each component, failed where something was found."""
    path.parent.mkdir(parents=True, exist_ok=True)
    found = dict.fromkeys(finding.component for finding in verdict.findings)
    names = list(dict.fromkeys([*verdict.judged, *found]))
    skipped = [name for name in unjudged(verdict.judged, verdict.not_judged) if name not in names]
    suite = ET.Element(
        "testsuite",
        name=f"quadftc diagnose {verdict.log}",
        tests=str(len(names) + len(skipped)),
        failures=str(len(found)),
        skipped=str(len(skipped)),
        time=f"{verdict.duration_s:.3f}",
    )
    for name in names:
        case = ET.SubElement(suite, "testcase", classname=verdict.log, name=name)
        for finding in verdict.findings:
            if finding.component == name:
                size = "" if finding.size is None else f" of {show(finding.size, finding.unit)}"
                message = f"{finding.name}: {finding.kind}{size} from {finding.onset_s:.3f} s"
                failure = ET.SubElement(case, "failure", message=message, type=finding.kind)
                failure.text = "\n".join(finding.evidence)
    for name in skipped:
        case = ET.SubElement(suite, "testcase", classname=verdict.log, name=name)
        reasons = [each.reason for each in verdict.not_judged if each.component == name]
        ET.SubElement(case, "skipped", message="; ".join(reasons))
    ET.indent(suite)
    return write_file(path, ET.tostring(suite, encoding="unicode", xml_declaration=True) + "\n")


def write_file(path: Path, text: str) -> Path:
    """Write a text so that nobody sees half of it."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
        stream.write(text)
    Path(name).chmod(0o644)
    return Path(name).replace(path)
