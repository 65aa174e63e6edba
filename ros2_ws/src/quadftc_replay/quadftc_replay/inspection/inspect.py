"""All tests on a log, and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.accelerometer import accelerometer_findings
from quadftc_replay.inspection.agreement import Agreement, compare
from quadftc_replay.inspection.attitude import attitude_findings, disagreements
from quadftc_replay.inspection.battery import battery_findings, cannot_judge_battery
from quadftc_replay.inspection.causes import first_cause
from quadftc_replay.inspection.compass import COMPONENT as COMPASS
from quadftc_replay.inspection.compass import Field, fields_of, owner_by_field
from quadftc_replay.inspection.deaf import deaf_findings
from quadftc_replay.inspection.ending import ending_of
from quadftc_replay.inspection.flight import Flight, prepare
from quadftc_replay.inspection.flown_by import flown_findings
from quadftc_replay.inspection.found import BODY_AXES, Found, component_name
from quadftc_replay.inspection.gyro import gyro_findings
from quadftc_replay.inspection.heading import heading_findings
from quadftc_replay.inspection.navigation import navigation_findings
from quadftc_replay.inspection.own_attitude import OwnEstimate, estimate, offset_finding, owner_of
from quadftc_replay.inspection.pairs import owner_by_other
from quadftc_replay.inspection.path import WINDOW
from quadftc_replay.inspection.readings import absent_findings, noise_findings, reading_findings
from quadftc_replay.inspection.response import response_findings
from quadftc_replay.inspection.rotors import judge_rotors
from quadftc_replay.inspection.steps import LIMITS, SLOWEST
from quadftc_replay.inspection.thrust import thrust_findings
from quadftc_replay.inspection.verdict import NotJudged, Verdict
from quadftc_replay.inspection.vibration import vibration_findings
from quadftc_replay.inspection.witnesses import is_tilt, pair_findings, path_findings
from quadftc_replay.inspection.wording import make_verdict

Progress = Callable[[float], None]
FEWEST = 200  # samples of a sensor
PATH_SEES = 1.5  # s; by which the path, over a window, may date what a pair shows too early
QUATERNION = ("",)  # the elements of an attitude are judged together


class Inspection(NamedTuple):
    """A verdict with all that shows it."""

    verdict: Verdict
    found: tuple[Found, ...]  # in the order of the verdict's findings
    flight: Flight


class _Inspection:
    """What is found, judged, and not judged, as the tests go on."""

    def __init__(self) -> None:
        self.found: list[Found] = []
        self.judged: list[str] = []
        self.missing: list[NotJudged] = []

    def cannot(self, component: str, reason: str) -> None:
        """Note that a component cannot be judged."""
        self.missing.append(NotJudged(component=component, reason=reason))


def inspect(
    log: FlightLog, baseline: FlightLog | None = None, progress: Progress = lambda _share: None
) -> Inspection:
    """Judge a log; ``baseline`` is a healthy flight of the same vehicle."""
    flight, inspection = prepare(log), _Inspection()
    gyros, ending = _gyros(flight), ending_of(flight)
    # sensor by sensor first: the later tests leave out what is blamed
    agreement = (
        compare(log.attitude, next(iter(gyros.values()))) if log.attitude is not None and gyros else None
    )
    progress(0.2)
    inspection.found += _readings(flight, gyros)
    progress(0.4)
    fields = fields_of(flight, ending.time_s if ending.kind == "out of control" else flight.until)
    found, judged = navigation_findings(flight, agreement, _longest(flight, None), fields)
    blamed = {each.finding.component for each in found}
    sound = [field for name, field in fields.items() if component_name(COMPASS, name) not in blamed]
    progress(0.5)
    _sensors(flight, gyros, agreement, sound, inspection)
    progress(0.7)
    inspection.found += found
    inspection.judged += judged
    rotors = judge_rotors(flight, baseline)
    inspection.found += rotors.found
    inspection.judged += ["rotor"] if rotors.judged else []
    inspection.missing += rotors.missing
    inspection.found += [*deaf_findings(flight), *response_findings(flight), *thrust_findings(flight)]
    progress(0.8)
    if (reason := cannot_judge_battery(flight)) is None:
        inspection.judged.append("battery")
        inspection.found += battery_findings(flight)
    else:
        inspection.cannot("battery", reason)
    inspection.found += [*flown_findings(flight), *vibration_findings(flight)]
    # a heading is wrong by itself only before all else fails
    others = [each.finding.onset_s for each in inspection.found]
    inspection.found += heading_findings(flight, min([*others, ending.time_s]))
    found, follows = first_cause(inspection.found, ending, log.events)
    progress(1.0)
    verdict = make_verdict(
        flight, baseline, ending, found, follows, inspection.judged, inspection.missing, rotors.model
    )
    return Inspection(verdict, tuple(found), flight)


def _gyros(flight: Flight) -> dict[str, Signal]:
    """All gyros, the main one first; else the estimated rate."""
    main = flight.gyro
    if main is None:
        return {}
    others = {name: each for name, each in flight.log.gyros.items() if name != main[0] and len(each) > 1}
    return {main[0]: main[1], **others}


def _readings(flight: Flight, gyros: dict[str, Signal]) -> list[Found]:
    found: list[Found] = []
    sensors = [("gyro", name, each) for name, each in gyros.items()]
    sensors += [("accelerometer", name, each) for name, each in flight.log.accelerometers.items()]
    for kind, name, sensor in sensors:
        component, unit = component_name(kind, name), LIMITS[kind].unit
        found += reading_findings(flight, component, sensor, BODY_AXES, unit)
        found += noise_findings(flight, component, sensor, BODY_AXES, unit, LIMITS[kind].floor)
        found += absent_findings(flight, component, sensor, _longest(flight, sensor))
    attitude = flight.log.attitude
    if attitude is not None and gyros:
        first = Signal(attitude.time, attitude.value[:, :1])
        found += reading_findings(flight, "attitude", first, QUATERNION, "1")
        found += absent_findings(flight, "attitude", attitude, next(iter(gyros.values())), to_the_end=False)
    return found


def _longest(flight: Flight, sensor: Signal | None) -> Signal | None:
    """Return the other signal that goes on longest, as a witness of a sensor that stops."""
    log = flight.log
    named = log.attitude, log.rotor_commands, log.rotor_speeds
    signals = [*log.gyros.values(), *log.accelerometers.values(), *named]
    others = [each for each in signals if each is not None and each is not sensor and len(each) > 1]
    return max(others, key=lambda each: (round(float(each.time[-1])), each.rate), default=None)


def _sensors(
    flight: Flight,
    gyros: dict[str, Signal],
    agreement: Agreement | None,
    fields: Sequence[Field],
    inspection: _Inspection,
) -> None:
    """Tests of the sensors against each other: pairs, which need no model, the path, steps."""
    log, known = flight.log, [each.finding for each in inspection.found]
    pairs = [*pair_findings(flight, "gyro", gyros, known)]
    pairs += pair_findings(flight, "accelerometer", log.accelerometers, known)
    is_own = log.attitude_from_gyro is not False
    paths, path = path_findings(flight, agreement if log.attitude_from_gyro else None)
    by_satellites = path is not None and path.window == WINDOW
    jumps, creeps = (
        ([], []) if agreement is None else disagreements(flight, agreement, log.attitude_from_gyro)
    )
    # a pair says which sensor is off, and sooner: the path counts before it alone
    begun = min((each.finding.onset_s for each in pairs), default=float("inf"))
    inspection.found += pairs + [
        each
        for each in paths
        if each.finding.onset_s < begun - PATH_SEES and not (path and is_tilt(each.finding, path, jumps))
    ]
    own, left = gyro_findings(flight, gyros, agreement, creeps, is_own)
    inspection.found += own
    gravity = _by_gravity(log, gyros)
    for name, sensor in gyros.items():
        component = component_name("gyro", name)
        if len(sensor) < FEWEST:
            inspection.cannot(component, f"{len(sensor)} samples are too few")
        elif len(gyros) > 1 or by_satellites or not is_own or sensor.rate >= SLOWEST:
            inspection.judged.append(component)
        else:
            reason = f"at {sensor.rate:.0f} Hz, without a second gyro, steps look like motion"
            inspection.cannot(component, reason)
    if not gyros:
        inspection.cannot("gyro", "no body rate is logged")
    # where attitude and gyro disagree, a third witness says whose it is: another gyro, a compass, gravity
    if agreement is not None:
        inspection.judged.append("attitude")
        main = gravity.get(next(iter(gyros)))
        inspection.found += attitude_findings(
            *(agreement, jumps, left, is_own),
            lambda creep: (
                owner_by_other(creep, gyros, is_own) or owner_by_field(creep, fields) or owner_of(creep, main)
            ),
        )
    elif log.attitude is None:
        inspection.cannot("attitude", "no attitude is logged")
    else:
        inspection.cannot("attitude", "there is no gyro that goes along with it")
    _accelerometers(flight, path is not None, inspection)
    inspection.found += _creeping(flight, gravity, agreement, inspection.found)


def _accelerometers(flight: Flight, has_path: bool, inspection: _Inspection) -> None:
    sensors = flight.log.accelerometers
    for name, sensor in sensors.items():
        component = component_name("accelerometer", name)
        if len(sensor) < FEWEST:
            inspection.cannot(component, f"{len(sensor)} samples are too few")
            continue
        if len(sensors) > 1 or has_path or (sensor.rate >= SLOWEST and flight.phases_known):
            inspection.judged.append(component)
        else:
            reason = "without a second one, motors or satellites, its steps look like motion"
            inspection.cannot(component, reason)
        others = [each for other, each in sensors.items() if other != name]
        inspection.found += accelerometer_findings(flight, component, sensor, others)
    if not sensors:
        inspection.cannot("accelerometer", "no specific force is logged")


def _creeping(
    flight: Flight, gravity: dict[str, OwnEstimate], agreement: Agreement | None, found: list[Found]
) -> list[Found]:
    """Gyros whose offset creeps against gravity, of those and accelerometers of which nothing is known."""
    known = {each.finding.component for each in found}
    if any(name.startswith("accelerometer") for name in known):
        return []
    attitude = flight.log.attitude
    main = next(iter(gravity), None)  # the gyro that was compared with the attitude
    creeps = [
        offset_finding(
            *(flight, component_name("gyro", name), own),
            agreement if name == main or attitude is None else compare(attitude, flight.log.gyros[name]),
        )
        for name, own in gravity.items()
        if component_name("gyro", name) not in known
    ]
    return [each for each in creeps if each is not None]


def _by_gravity(log: FlightLog, gyros: dict[str, Signal]) -> dict[str, OwnEstimate]:
    """Estimate attitude and offset of each gyro by the main accelerometer, where they allow it."""
    force = next(iter(log.accelerometers.values()), None)
    if force is None:
        return {}
    found = {name: estimate(log, sensor, force) for name, sensor in gyros.items()}
    return {name: own for name, own in found.items() if own is not None}
