"""`quadftc diagnose` without its screen: read a log, put faults on it, judge it, write what came out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

from quadftc_flight.junit import Case, Failure, write_file, write_junit
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.calibration import level_for
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.inspection.inspect import Inspection, Progress, inspect
from quadftc_replay.inspection.overlay import overlay_faults
from quadftc_replay.inspection.verdict import Verdict, doubted, show, unjudged
from quadftc_replay.inspection.wording import apply_level
from quadftc_replay.overlay import faults_from
from quadftc_replay.readers import ONLY_ONE, LogChoice
from quadftc_replay.readers.bounded import read_bounded

VERDICT = "verdict.json"
READING = 0.2  # share of the work


@dataclasses.dataclass(frozen=True, kw_only=True)
class DiagnosisOptions:
    """What to judge, and how."""

    baseline: Path | None = None  # healthy flight of the same vehicle
    faults: tuple[str, ...] = ()  # specifications of faults to overlay
    choice: LogChoice = ONLY_ONE  # which log of the file, and how it is read
    baseline_log: int = 0  # of several in the file of the baseline, from 1; 0: the only one
    vehicle: str = ""  # name or TOML file, for the layout of the rotors; empty: what the log says
    seed: int = 0  # of random faults
    false_alarms: str = ""  # level that was asked for, such as "1/10h"; empty: all findings count


def diagnose_log(
    path: Path, options: DiagnosisOptions, progress: Progress = lambda _share: None
) -> Inspection:
    """Read and judge a log; a ValueError of one line says what is wrong with it or with the options."""
    faults = faults_from((), options.faults)
    log = read_with_layout(path, options.vehicle, options.choice)
    baseline = None
    level = level_for(options.false_alarms, log.format) if options.false_alarms else None
    if options.baseline is not None:
        if level is not None:
            raise ValueError("--false-alarms takes no --baseline: no flight was calibrated with one")
        choice = options.choice._replace(log=options.baseline_log)
        baseline = read_with_layout(options.baseline, options.vehicle, choice)
    progress(READING)
    if faults:
        log = overlay_faults(log, faults, options.seed)
    inspection = inspect(log, baseline, lambda share: progress(READING + (1.0 - READING) * share))
    if level is None:
        return inspection
    verdict = apply_level(inspection.verdict, inspection.flight, level)
    found = tuple(each for each in inspection.found if each.finding in verdict.findings)
    return inspection._replace(verdict=verdict, found=found)


def read_with_layout(path: Path, vehicle: str, choice: LogChoice = ONLY_ONE) -> FlightLog:
    """Read a log in a process of its own; add where the rotors are, by a vehicle file."""
    log = read_bounded(path, choice)
    name = vehicle or log.vehicle
    if not name or (log.rotor_positions is not None and not vehicle):
        return log
    rotors = load_vehicle(name).rotors
    return dataclasses.replace(
        log, vehicle=name, rotor_positions=rotors.positions, rotor_yaw_signs=rotors.yaw_sign
    )


def write_verdict(verdict: Verdict, directory: Path, name: str = VERDICT) -> Path:
    """Write a verdict as JSON; an earlier one is replaced when the new one is whole."""
    directory.mkdir(parents=True, exist_ok=True)
    return write_file(directory / name, verdict.model_dump_json(indent=2) + "\n")


def write_verdict_junit(verdict: Verdict, path: Path) -> Path:
    """Write the verdict as JUnit XML: one test case for each component, failed where something was found."""
    names = dict.fromkeys([*verdict.judged, *(finding.component for finding in verdict.findings)])
    cases = [
        Case(verdict.log, name, tuple(_failures(verdict, name)), doubted(verdict, name)) for name in names
    ]
    for name in unjudged(verdict.judged, verdict.not_judged):
        if name not in names:
            reasons = [each.reason for each in verdict.not_judged if each.component == name]
            cases.append(Case(verdict.log, name, skipped="; ".join(reasons)))
    return write_junit(path, f"quadftc diagnose {verdict.log}", cases, verdict.duration_s)


def _failures(verdict: Verdict, component: str) -> Iterator[Failure]:
    for finding in verdict.findings:
        if finding.component == component:
            size = "" if finding.size is None else f" of {show(finding.size, finding.unit)}"
            message = f"{finding.name}: {finding.kind}{size} from {finding.onset_s:.3f} s"
            yield Failure(message, finding.kind, "\n".join(finding.evidence))
