"""All tests on a log, and the verdict."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.accelerometer import accelerometer_findings
from quadftc_replay.inspection.agreement import Agreement, compare
from quadftc_replay.inspection.attitude import attitude_findings, disagreements
from quadftc_replay.inspection.battery import battery_findings, cannot_judge_battery
from quadftc_replay.inspection.flight import Flight, prepare
from quadftc_replay.inspection.found import Found
from quadftc_replay.inspection.gyro import BODY_AXES, Witness, component_name, gyro_findings
from quadftc_replay.inspection.identification import Identified
from quadftc_replay.inspection.own_attitude import OwnEstimate, estimate, offset_finding, owner_of
from quadftc_replay.inspection.readings import absent_findings, noise_findings, reading_findings
from quadftc_replay.inspection.rotors import judge_rotors
from quadftc_replay.inspection.steps import SLOWEST
from quadftc_replay.inspection.verdict import VERSION, Finding, Model, NotJudged, Verdict, summarise

Progress = Callable[[float], None]
SENSORS = {"gyro": ("rad/s", "gyros"), "accelerometer": ("m/s^2", "accelerometers")}
SLOWEST_COMPARED = 40.0  # Hz; a slower gyro misses what happens between its samples
FEWEST = 200  # samples of a sensor
SHAKES_BEFORE = 0.6  # s; tests over windows see what begins so much earlier
QUATERNION = ("",)  # the elements of an attitude are judged together


class Inspection(NamedTuple):
    """A verdict with all that shows it."""

    verdict: Verdict
    found: tuple[Found, ...]  # in the order of the verdict's findings
    flight: Flight
    agreement: Agreement | None


def inspect(
    log: FlightLog, baseline: FlightLog | None = None, progress: Progress = lambda _share: None
) -> Inspection:
    """Judge a log; ``baseline`` is a healthy flight of the same vehicle."""
    flight = prepare(log)
    found: list[Found] = []
    judged: list[str] = []
    missing: list[NotJudged] = []
    gyros = _gyros(flight)
    agreement = None
    if log.attitude is not None and gyros:
        main = next(iter(gyros.values()))
        agreement = compare(log.attitude, main) if main.rate > SLOWEST_COMPARED else None
    progress(0.2)
    found += _readings(flight, gyros)
    progress(0.4)
    found += _sensors(flight, gyros, agreement, judged, missing)
    rotors = judge_rotors(flight, baseline)
    found = [each for each in found if not _follows(each.finding, rotors.found)] + rotors.found
    judged += ["rotor"] if rotors.judged else []
    missing += rotors.missing
    progress(0.8)
    if (reason := cannot_judge_battery(flight)) is None:
        judged.append("battery")
        found += battery_findings(flight)
    else:
        missing.append(NotJudged(component="battery", reason=reason))
    found = _in_order(_without_doubles(found))
    progress(1.0)
    return Inspection(
        _verdict(flight, baseline, found, judged, missing, rotors.model), tuple(found), flight, agreement
    )


def _gyros(flight: Flight) -> dict[str, Signal]:
    """All gyros, the main one first; else the estimated rate."""
    main = flight.gyro
    if main is None:
        return {}
    others = {name: each for name, each in flight.log.gyros.items() if name != main[0] and len(each) > 1}
    return {main[0]: main[1], **others}


def _readings(flight: Flight, gyros: dict[str, Signal]) -> list[Found]:
    """Tests of each sensor by its readings alone."""
    found: list[Found] = []
    sensors = [("gyro", name, each) for name, each in gyros.items()]
    sensors += [("accelerometer", name, each) for name, each in flight.log.accelerometers.items()]
    for kind, name, sensor in sensors:
        component, unit = component_name(kind, name), SENSORS[kind][0]
        other = next((each for which, called, each in sensors if (which, called) != (kind, name)), None)
        found += reading_findings(flight, component, sensor, BODY_AXES, unit)
        found += noise_findings(flight, component, sensor, BODY_AXES, unit)
        found += absent_findings(flight, component, sensor, other or flight.log.attitude)
    attitude = flight.log.attitude
    if attitude is not None and gyros:
        found += reading_findings(
            flight, "attitude", Signal(attitude.time, attitude.value[:, :1]), QUATERNION, "1"
        )
        found += absent_findings(flight, "attitude", attitude, next(iter(gyros.values())), to_the_end=False)
    return found


def _sensors(
    flight: Flight,
    gyros: dict[str, Signal],
    agreement: Agreement | None,
    judged: list[str],
    missing: list[NotJudged],
) -> list[Found]:
    """Tests of the sensors against each other."""
    log, found = flight.log, list[Found]()
    is_own = log.attitude_from_gyro is not False
    jumps, creeps = (
        ([], []) if agreement is None else disagreements(flight, agreement, log.attitude_from_gyro)
    )
    witness = Witness(agreement, creeps, not is_own) if agreement is not None else None
    own, left = gyro_findings(flight, gyros, witness)
    found += own
    gravity = _by_gravity(log, gyros)
    for name, sensor in gyros.items():
        component = component_name("gyro", name)
        if len(sensor) < FEWEST:
            missing.append(NotJudged(component=component, reason=f"{len(sensor)} samples are too few"))
        elif sensor.rate < SLOWEST and witness is None:
            reason = f"{sensor.rate:.0f} Hz is too slow: steps look like motion below {SLOWEST:.0f} Hz"
            missing.append(NotJudged(component=component, reason=reason))
        else:
            judged.append(component)
    if not gyros:
        missing.append(NotJudged(component="gyro", reason="no body rate is logged"))
    if agreement is not None:
        judged.append("attitude")
        main = gravity.get(next(iter(gyros)))
        found += attitude_findings(agreement, jumps, left, is_own, lambda creep: owner_of(creep, main))
    elif log.attitude is None:
        missing.append(NotJudged(component="attitude", reason="no attitude is logged"))
    elif not gyros:
        missing.append(NotJudged(component="attitude", reason="there is no gyro to compare it with"))
    else:
        rate = next(iter(gyros.values())).rate
        reason = f"the gyro, at {rate:.0f} Hz, is too slow or too short to follow it"
        missing.append(NotJudged(component="attitude", reason=reason))
    found += _accelerometers(flight, judged, missing)
    return found + _creeping(flight, gravity, agreement, found)


def _accelerometers(flight: Flight, judged: list[str], missing: list[NotJudged]) -> list[Found]:
    """Tests of every accelerometer."""
    found, sensors = list[Found](), flight.log.accelerometers
    for name, sensor in sensors.items():
        component = component_name("accelerometer", name)
        if len(sensor) < FEWEST:
            missing.append(NotJudged(component=component, reason=f"{len(sensor)} samples are too few"))
            continue
        judged.append(component)
        others = [each for other, each in sensors.items() if other != name]
        found += accelerometer_findings(flight, component, sensor, others)
    if not sensors:
        missing.append(NotJudged(component="accelerometer", reason="no specific force is logged"))
    return found


def _creeping(
    flight: Flight, gravity: dict[str, OwnEstimate], agreement: Agreement | None, found: list[Found]
) -> list[Found]:
    """Gyros whose offset creeps against gravity, of those and accelerometers of which nothing is known."""
    known = {each.finding.component for each in found}
    if any(name.startswith("accelerometer") for name in known):
        return []
    main = next(iter(gravity), None)  # the gyro that was compared with the attitude
    creeps = [
        offset_finding(flight, component_name("gyro", name), own, agreement if name == main else None)
        for name, own in gravity.items()
        if component_name("gyro", name) not in known
    ]
    return [each for each in creeps if each is not None]


def _by_gravity(log: FlightLog, gyros: dict[str, Signal]) -> dict[str, OwnEstimate]:
    """Estimate attitude and offset of each gyro by the main accelerometer, where they allow it."""
    force = next(iter(log.accelerometers.values()), None)
    if force is None:
        return {}
    found = {name: estimate(sensor, force) for name, sensor in gyros.items()}
    return {name: own for name, own in found.items() if own is not None}


def _without_doubles(found: list[Found]) -> list[Found]:
    """Of findings on one element at one time keep the first: readings tell more than comparisons."""
    kept: list[Found] = []
    for each in found:
        if not any(_repeats(each.finding, other.finding) for other in kept):
            kept.append(each)
    return kept


def _repeats(finding: Finding, known: Finding) -> bool:
    """Whether a finding only shows what a reading that is stuck, saturated or absent makes."""
    if known.kind not in ("stuck", "saturation", "absent", "noise"):
        return False
    is_same = known.component == finding.component or (
        known.component in [each.partition("/")[0] for each in finding.ambiguous_with]
    )
    end = float("inf") if known.end_s is None else known.end_s
    ends = float("inf") if finding.end_s is None else finding.end_s
    overlaps = known.onset_s - 1.0 <= ends and finding.onset_s <= end + 1.0
    if known.component == finding.component and known.kind == finding.kind:
        return known.element == finding.element
    return bool(is_same) and overlaps and finding.kind in ("offset", "noise", "unknown", "absent")


def _follows(finding: Finding, losses: list[Found]) -> bool:
    """Whether a finding on a sensor begins after a rotor failed: what is abrupt then is real motion."""
    onsets = [each.finding.onset_s for each in losses if each.shakes]
    return (
        bool(onsets)
        and finding.kind in ("offset", "noise", "saturation", "unknown")
        and finding.onset_s > min(onsets) - SHAKES_BEFORE
    )


def _in_order(found: list[Found]) -> list[Found]:
    return sorted(found, key=lambda each: (-round(each.finding.probability, 2), each.finding.onset_s))


def _verdict(
    flight: Flight,
    baseline: FlightLog | None,
    found: list[Found],
    judged: list[str],
    missing: list[NotJudged],
    model: Identified | None,
) -> Verdict:
    log = flight.log
    findings = [each.finding for each in found]
    notes = [*log.notes]
    if flight.rate_is_estimated:
        notes.append("no gyro is logged; the vehicle's own estimate of the body rate took its place")
    if not flight.phases_known:
        notes.append("neither rotors nor thrust tell when it flies: the whole log was judged")
    if log.attitude is not None and log.attitude_from_gyro is not False:
        words = (
            "the attitude is computed from this gyro"
            if log.attitude_from_gyro
            else "the attitude may be computed from this gyro"
        )
        notes.append(f"{words}: an error of the gyro that it followed does not show between them")
    return Verdict(
        version=VERSION,
        log=log.path.name,
        format=log.format,
        duration_s=log.end,
        flight_s=flight.duration,
        baseline=baseline.path.name if baseline is not None else None,
        healthy=not findings,
        sentence=summarise(findings, judged, missing),
        findings=tuple(findings),
        not_judged=tuple(missing),
        judged=tuple(judged),
        model=None if model is None else _model(model),
        notes=tuple(notes),
    )


def _model(model: Identified) -> Model:
    roll, pitch, yaw = (float(value) for value in model.r2[:3])
    usable = (bool(model.usable[0]), bool(model.usable[1]), bool(model.usable[2]))
    return Model(source=model.source, lag_s=model.lag, r2=(roll, pitch, yaw), usable=usable)  # type: ignore[arg-type]
