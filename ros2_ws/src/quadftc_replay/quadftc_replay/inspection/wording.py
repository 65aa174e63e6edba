"""The verdict in words: headline, timeline, and what to log in the next flight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from quadftc_replay.flight_log import FlightLog, Signal, Watched
from quadftc_replay.inspection.battery import UNMEASURED
from quadftc_replay.inspection.causes import reported_failure
from quadftc_replay.inspection.ending import AT_LIMIT
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import Found
from quadftc_replay.inspection.identification import Identified
from quadftc_replay.inspection.verdict import (
    VERSION,
    Ending,
    Finding,
    Level,
    Model,
    Moment,
    NotJudged,
    Outcome,
    Verdict,
    join,
    show,
)
from quadftc_replay.inspection.whitening import runs_of

REQUIRED = ("gyro", "accelerometer", "attitude", "rotor", "battery")  # what can bring a vehicle down
SENTENCE_FINDINGS = 3  # findings that the sentence names
BELOW = "below the level that was asked for"
BEYOND = 0.5  # s; of a signal beyond its limit: manoeuvres take outputs to theirs for less
PAUSE = 2.0  # s; shorter pauses do not end that
LIMITS_SHOWN = 5  # of one signal
PLAIN = ("in flight", "landed")  # endings that go without saying
# how a format begins, or a vehicle of it: what to set so that all can be judged
ADVICE = {
    "ArduCopter": "set LOG_BITMASK bits 0 (fast attitude), 1 (attitude), 10 (RC output) and 18 (fast IMU)",
    "ArduPilot": "log attitude, IMU and RC output at full rate (LOG_BITMASK)",
    "PX4": "set SDLOG_PROFILE bit 4 (high rate)",
    "Crazyflie": "log gyro, acc, stateEstimate (attitude), motor.m1 to m4 and pm.vbat at 100 Hz or more",
    "": "log gyro, accelerometer, attitude, rotor commands or speeds, and the voltage at 100 Hz or more",
}


def make_verdict(
    flight: Flight,
    baseline: FlightLog | None,
    ending: Ending,
    found: Sequence[Found],
    follows: Sequence[Found],
    judged: Sequence[str],
    missing: Sequence[NotJudged],
    model: Identified | None,
) -> Verdict:
    """Put what was found into words; ``follows`` are findings that others explain."""
    log, findings = flight.log, [each.finding for each in found]
    outcome = outcome_of(flight, findings, judged, ending)
    return Verdict(
        version=VERSION,
        log=log.path.name,
        format=log.format,
        duration_s=log.end,
        flight_s=flight.duration,
        baseline=baseline.path.name if baseline is not None else None,
        outcome=outcome,
        healthy=outcome == "healthy",
        sentence=summarise(flight, outcome, findings, judged, missing, ending),
        level=None,
        findings=tuple(findings),
        ending=ending,
        timeline=tuple(sorted(_moments(flight, findings, follows, ending), key=lambda each: each.time_s)),
        not_judged=tuple(missing),
        judged=tuple(judged),
        model=None if model is None else _model(model),
        advice=tuple(_advice(log, judged, missing)) if outcome == "not enough to say" else (),
        notes=tuple(_notes(flight)),
    )


def apply_level(verdict: Verdict, flight: Flight, level: Level) -> Verdict:
    """Move findings below a level to the timeline; a flight that has such findings alone is not healthy."""
    kept = tuple(each for each in verdict.findings if each.probability > level.threshold)
    below = [_describe(each) for each in verdict.findings if each not in kept]
    if not below:
        return verdict.model_copy(update={"level": level})
    outcome: Outcome = "fault" if kept else "not enough to say"
    doubtful = f"{len(below)} finding{'s are' if len(below) > 1 else ' is'} {BELOW}, {level.asked}"
    said = summarise(flight, outcome, kept, verdict.judged, verdict.not_judged, verdict.ending, doubtful)
    changed = {
        "level": level,
        "outcome": outcome,
        "healthy": False,
        "findings": kept,
        "sentence": said,
        "timeline": tuple(
            each.model_copy(update={"text": f"{BELOW}: {each.text}"}) if each.text in below else each
            for each in verdict.timeline
        ),
    }
    return verdict.model_copy(update=changed)


def _lacks(judged: Sequence[str]) -> list[str]:
    """Return what can bring a vehicle down and was not judged."""
    return [each for each in REQUIRED if each not in judged]


def outcome_of(flight: Flight, findings: Sequence[Finding], judged: Sequence[str], ending: Ending) -> Outcome:
    """Say which of three outcomes it is; a failure that the autopilot alone reports leaves it open."""
    if findings:
        return "fault"
    is_open = flight.log.incomplete or _lacks(judged) or ending.kind == "out of control"
    is_open = is_open or reported_failure(flight) is not None
    return "not enough to say" if is_open else "healthy"


def summarise(
    flight: Flight,
    outcome: Outcome,
    findings: Sequence[Finding],
    judged: Sequence[str],
    missing: Sequence[NotJudged],
    ending: Ending,
    doubtful: str = "",
) -> str:
    """Say the verdict in one sentence, what matters most first; ``doubtful`` tells of findings left out."""
    ended = "" if ending.kind in PLAIN else ending.sentence
    if outcome == "fault":
        parts = [_describe(each) for each in findings[:SENTENCE_FINDINGS]]
        more = len(findings) - SENTENCE_FINDINGS
        parts += [f"{more} more finding{'s' if more > 1 else ''}"] if more > 0 else []
        text = join(parts) + (f"; then: {ended}" if ended else "")
        text += f"; the log is not whole ({flight.log.incomplete})" if flight.log.incomplete else ""
        text += f"; {doubtful}" if doubtful else ""
    elif outcome == "healthy":
        # a log that ends in the air may be cut, also where its format has no mark for the end
        in_air = ending.kind == "in flight" and flight.phases_known
        of = "until the log ends in flight" if in_air else "over the whole flight"
        all_of_it = f"{join([*REQUIRED])} were judged {of}, {flight.duration:.0f} s"
        text = f"{ended}; no fault found: {all_of_it}" if ended else f"No fault found: {all_of_it}"
    else:
        text = _why_not(flight, judged, missing, ended, doubtful)
    return f"{text[0].upper()}{text[1:]}."


def _why_not(
    flight: Flight, judged: Sequence[str], missing: Sequence[NotJudged], ended: str, doubtful: str
) -> str:
    log, reported = flight.log, reported_failure(flight)
    said = f'the autopilot reports "{reported.text}" at {reported.time:.1f} s' if reported else ""
    cut = f"the log is not whole ({log.incomplete})" if log.incomplete else ""
    lacking = _lacks(judged)
    reasons = join([f"{name} ({_reason(name, missing)})" for name in lacking])
    left = f"{reasons} could not be judged" if reasons else ""
    open_ = join([each for each in (doubtful, said, cut, left) if each])
    parts = [ended, f"not enough to say: {open_}" if open_ else "the cause is not known"]
    parts.append(f"no fault found in {join(list(judged))}" if judged else "")
    return "; ".join(filter(None, parts))


def _reason(component: str, missing: Sequence[NotJudged]) -> str:
    return next((each.reason for each in missing if each.component == component), "it is not logged")


def _advice(log: FlightLog, judged: Sequence[str], missing: Sequence[NotJudged]) -> Iterator[str]:
    """Say what to change for the next flight, so that all can be judged."""
    is_unmeasured = any(UNMEASURED in each.reason for each in missing)
    if any(each != "battery" or not is_unmeasured for each in _lacks(judged)):
        yield advice_for(log)
    if is_unmeasured:
        yield "connect what measures the battery, and calibrate its voltage"


def advice_for(log: FlightLog) -> str:
    """Return what to set for the next flight, by the words of autopilot and vehicle."""
    said = " ".join(each.text for each in log.events)
    is_copter = "Frame: " in said or "ArduCopter" in said or log.rotor_positions is not None
    if log.format.startswith("ArduPilot"):
        return ADVICE["ArduCopter" if is_copter else "ArduPilot"]
    return next((text for name, text in ADVICE.items() if name and log.format.startswith(name)), ADVICE[""])


def _moments(
    flight: Flight, findings: Sequence[Finding], follows: Sequence[Found], ending: Ending
) -> Iterator[Moment]:
    for finding in findings:
        yield Moment(time_s=finding.onset_s, source="diagnose", text=_describe(finding))
    for each in follows:
        finding = each.finding
        is_cause = any(f"{finding.component}/{finding.element}" in one.ambiguous_with for one in findings)
        how = "it may be the cause instead" if is_cause else "it follows"
        yield Moment(time_s=finding.onset_s, source="diagnose", text=f"{how}: {_describe(finding)}")
    yield Moment(time_s=ending.time_s, source="diagnose", text=ending.sentence)
    yield from _limit_moments(flight)
    for event in flight.log.events:
        yield Moment(time_s=event.time, source=event.source, text=event.text)


def _notes(flight: Flight) -> Iterator[str]:
    log = flight.log
    yield from log.notes
    if flight.rate_is_estimated:
        yield "no gyro is logged; the vehicle's own estimate of the body rate took its place"
    if not flight.phases_known:
        yield "neither rotors nor thrust tell when it flies: the whole log was judged"
    if log.attitude is not None and log.attitude_from_gyro is not False:
        may = "is" if log.attitude_from_gyro else "may be"
        said = "an error of the gyro that it followed does not show between them"
        yield f"the attitude {may} computed from this gyro: {said}"


def _model(model: Identified) -> Model:
    roll, pitch, yaw = (float(value) for value in model.r2[:3])
    usable = (bool(model.usable[0]), bool(model.usable[1]), bool(model.usable[2]))
    return Model(source=model.source, lag_s=model.lag, r2=(roll, pitch, yaw), usable=usable)  # type: ignore[arg-type]


def _describe(finding: Finding) -> str:
    size = f" of {show(finding.size, finding.unit)}" if finding.size is not None else ""
    are_all = finding.name == "all rotors"
    what = {
        "offset": f"{finding.name} has an offset{size}",
        "drift": f"{finding.name} drifts{size.replace(' of ', ' by ')}",
        "interference": f"{finding.name} follows the rotors{size.replace(' of ', ' by ')}",
        "stuck": f"{finding.name} is stuck",
        "saturation": f"{finding.name} is saturated",
        "noise": f"{finding.name} is {'harmful' if finding.component == 'vibration' else 'noisy'}",
        "absent": f"{finding.name} gives no usable reading",
        "loss": f"{finding.name} lost {_share(finding.size)} of {'their' if are_all else 'its'} thrust",
        "off": f"{finding.name} {'give' if are_all else 'gives'} no thrust",
        "brownout": f"{finding.name} breaks down",
        "rise": f"{finding.name} rises{size.replace(' of ', ' by ')}",
        "reversed": f"{_axes(finding)} the wrong way",
        "exchanged": f"{_axes(finding)} about another axis",
        "unknown": f"{finding.name} is at fault",
    }[finding.kind]
    until = "" if finding.end_s is None else f" to {finding.end_s:.2f} s"
    others = join([each.replace("/", " ") for each in finding.ambiguous_with], "or")
    doubt = f" (or {others})" if others else ""
    return f"{what} from {finding.onset_s:.2f} s{until}{doubt}"


def _axes(finding: Finding) -> str:
    """Begin a sentence of axes that answer; what follows says how."""
    axes = finding.element.split(",")
    is_one = len(axes) == 1
    return f"{join(axes)} {'answers its command' if is_one else 'answer their commands'}"


def _share(size: float | None) -> str:
    return "part" if size is None else f"{100.0 * size:.0f} %"


def _limit_moments(flight: Flight) -> Iterator[Moment]:
    """Say when a signal with a limit is beyond it in flight, and when a rotor has no more to give."""
    for each in (*flight.log.watched, *_outputs(flight)):
        time, value = each.signal.time, each.signal.value[:, 0]
        beyond = (value < each.limit) if each.is_least else (value > each.limit)
        beyond &= flight.in_flight(time)
        shown = 0
        for start, end, rows in _stretches(time, beyond):
            is_long = end - start >= BEYOND or each.unit == "V" or each.limit == 0.0
            if is_long and shown < LIMITS_SHOWN:
                worst = float(value[rows].min() if each.is_least else value[rows].max())
                bound = f"{'least' if each.is_least else 'limit'} {each.limit:.3g}"
                lasted = f" for {end - start:.1f} s" if end > start else ""
                text = f"{each.name}: {worst:.3g} {each.unit}".strip() + f", {bound}{lasted}"
                yield Moment(time_s=start, source="log", text=text)
                shown += 1


def _outputs(flight: Flight) -> Iterator[Watched]:
    """Commands of rotors, none of which may be at its limit for long."""
    commands = flight.log.rotor_commands
    for rotor in range(0 if commands is None else commands.value.shape[1]):
        assert commands is not None
        signal = Signal(commands.time, np.nan_to_num(commands.value[:, rotor : rotor + 1]))
        yield Watched(f"rotor {rotor + 1} has no more to give, command", signal, AT_LIMIT)


def _stretches(time: np.ndarray, beyond: np.ndarray) -> Iterator[tuple[float, float, slice]]:
    """Begin [s], end [s] and rows of what is beyond, short pauses included."""
    runs = runs_of(beyond)
    while runs:
        first = last = runs.pop(0)
        while runs and time[runs[0].start] - time[last.stop - 1] < PAUSE:
            last = runs.pop(0)
        yield float(time[first.start]), float(time[last.stop - 1]), slice(first.start, last.stop)
