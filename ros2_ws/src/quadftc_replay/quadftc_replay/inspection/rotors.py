"""Tests of the rotors: one that stands still, one that is lost in flight, one that is weak all along."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight, Interval, prepare, row_means
from quadftc_replay.inspection.found import CERTAIN, Curve, Found, confidence, make_found
from quadftc_replay.inspection.identification import STANDS, Identified, identify
from quadftc_replay.inspection.rotor_step import LEVEL as STEP_LEVEL
from quadftc_replay.inspection.rotor_step import RotorStep, find_step, torque_by_model, torque_of
from quadftc_replay.inspection.rotor_trim import SHARPER, Weak, effects, find_weak, rotor_thrusts, trim_of
from quadftc_replay.inspection.verdict import NotJudged
from quadftc_replay.inspection.whitening import Floats, runs_of

AT_ONCE = 0.15  # s; within which a controller stops the opposite rotor
STILL_FLYING = 0.7  # 1; of their usual speed, that the others have meanwhile
FALLS = 3.0  # s; that a flight goes on after what is judged, as in a crash
SLOWS = 0.3  # 1; of the steepest fall of its speed, at which the fall begins
FALL, STEP = 0.5, 0.02  # s; before it stands; over which its fall is measured
STANDS_FOR = 0.1  # s; though it was told to turn
STOPS_FOR = 0.25  # s; else: manoeuvres stop rotors for less
UNASKED = 0.8  # probability that it is a fault, where nobody knows what it was told
ASKED = 0.6  # where it was told to: whoever flies on three rotors tells the fourth to stand
TURNS_IN = 0.3  # s; within which a vehicle turns after a rotor has stopped
HALF = 0.5  # 1; of a rotor's thrust: a loss that has to show in a flight that is called healthy
ALL_OF_IT = 0.75  # 1; share of the thrust from which a rotor is off


class Rotors(NamedTuple):
    """What was found of the rotors, and by what model."""

    found: list[Found]
    model: Identified | None
    judged: bool
    missing: list[NotJudged]


def judge_rotors(flight: Flight, baseline: FlightLog | None) -> Rotors:
    """Test the rotors of a flight; ``baseline`` is a healthy flight of the same vehicle."""
    log = flight.log
    if log.rotor_speeds is None and log.rotor_commands is None and log.torque_command is None:
        return Rotors([], None, False, [_not_judged("neither rotor commands nor speeds are logged")])
    if not flight.lifts_off:
        return Rotors([], None, False, [_not_judged("the ground holds the vehicle whenever the rotors turn")])
    has_rotors = log.rotor_speeds is not None or log.rotor_commands is not None
    torque, model = torque_of(flight), None
    if torque is None:
        model = identify(flight)
        torque = None if model is None else torque_by_model(flight, model)
    step, shows = (None, None) if torque is None else find_step(flight, torque)
    can_see_loss = step is not None or (shows is not None and shows < HALF)
    standing = list(_standing(flight))
    stands = (each for each in standing if each.finding.component == "rotor")
    stopped = min(stands, key=lambda each: each.finding.onset_s, default=None)
    found = first_failed(stopped, None if step is None else _step_found(step))
    found += [each for each in standing if each.finding.component != "rotor"]
    trim, missing = trim_of(flight), list[NotJudged]()
    if trim is not None:
        healthy = None if baseline is None else trim_of(prepare(baseline))
        weak = find_weak(trim, healthy, effects(log))
        # after a loss the trim is that of a vehicle without the rotor
        if weak is not None and not found:
            found.append(_weak_found(flight, weak, healthy is not None))
        if baseline is not None and healthy is None:
            missing.append(_not_judged("the baseline has no steady flight with rotor commands or speeds"))
    if not can_see_loss:
        missing.append(_not_judged(_why_no_loss(flight, has_rotors, model, shows)))
    if baseline is not None and effects(log) is None:
        missing.append(_not_judged("a baseline is of no use where their layout is not known"))
    return Rotors(found, model, has_rotors and can_see_loss, missing)


def _why_no_loss(flight: Flight, has_rotors: bool, model: Identified | None, shows: float | None) -> str:
    if shows is not None:
        return f"in this flight a loss of {100 * min(shows, 1.0):.0f} % of a rotor's thrust would not show"
    if not has_rotors:
        return "only the torque of all rotors together is logged"
    if flight.gyro is None:
        return "no body rate is logged beside the rotors"
    if model is not None:
        shares = " and ".join(f"{value:.2f}" for value in model.r2[:2])
        return f"their layout is not known, and the flight hardly excites roll and pitch (R² {shares})"
    return (
        "their layout is not known, and commands or speeds are slower than 25 Hz, or there are less than 4 s"
    )


def _step_found(step: RotorStep) -> Found:
    others = () if step.second is None else (f"rotor/{step.second + 1}",)
    said = [
        f"from {step.onset:.2f} s on the vehicle turns as if {100 * step.share:.0f} % of its thrust"
        " were missing;"
        f" what the controller asks for against it is not followed, by {step.score:.0f} standard deviations"
    ]
    if step.spells > 1:
        until = "the end" if step.end is None else f"{step.end:.2f} s"
        said.append(
            f"it is gone {step.spells} times until {until}, as with an ESC out of step or a loose wire"
        )
    elif step.end is not None:
        said.append(f"it is back at {step.end:.2f} s; a push from outside for so long looks the same")
    pushed = ("push from outside",) if step.spells == 1 and step.end is not None else ()
    lines = {"roll": step.rest[:, 0], "pitch": step.rest[:, 1]}
    return make_found(
        *("rotor", str(step.rotor + 1), "off" if step.share > ALL_OF_IT else "loss", step.onset),
        end_s=step.end,
        size=step.share,
        sigma=step.sigma,
        unit="1",
        probability=confidence(step.score, 0.5 * STEP_LEVEL) * (0.6 if others else 1.0),
        ambiguous_with=(*others, *pushed),
        evidence=tuple(said),
        curve=Curve("torque not followed", "1", step.time, lines),
    )


def first_failed(stopped: Found | None, lost: Found | None) -> list[Found]:
    """Keep the rotor that failed first: a controller that flies on stops others, perhaps at once."""
    if stopped is None or lost is None:
        return [each for each in (stopped, lost) if each is not None]
    early, late = sorted((stopped, lost), key=lambda each: each.finding.onset_s)
    if stopped.finding.element == lost.finding.element:
        said = tuple(dict.fromkeys([*stopped.finding.evidence, *lost.finding.evidence]))
        surer = max((stopped.finding, lost.finding), key=lambda each: each.probability)
        finding = stopped.finding.model_copy(
            update={
                "onset_s": early.finding.onset_s,
                "probability": surer.probability,
                "ambiguous_with": surer.ambiguous_with,
                "evidence": said,
            }
        )
        return [Found(finding, stopped.curve or lost.curve)]
    return [lost if late.finding.onset_s - early.finding.onset_s < AT_ONCE else early]


def _not_judged(reason: str) -> NotJudged:
    return NotJudged(component="rotor", reason=reason)


def _standing(flight: Flight) -> Iterator[Found]:
    """Say which rotor stands still in flight, by its measured speed."""
    sensor = flight.log.rotor_speeds
    if sensor is None or len(sensor) < 20:
        return
    speeds = np.abs(np.nan_to_num(sensor.value))
    flying = flight.in_flight(sensor.time)
    if not flying.any():
        return
    usual = float(np.median(speeds[flying]))
    falling = np.zeros(len(flying), np.bool_)
    for each in flight.intervals:
        falling |= (sensor.time > each.end) & (sensor.time < each.end + FALLS)
    for rotor in range(speeds.shape[1]):
        others = np.median(np.delete(speeds, rotor, axis=1), axis=1)
        there = flying | (falling & (others > STILL_FLYING * usual))
        stands = there & (speeds[:, rotor] < STANDS * others)
        for run in runs_of(stands):
            start, end = float(sensor.time[run.start]), float(sensor.time[run.stop - 1])
            onset = _slows_down(sensor.time, speeds[:, rotor], run.start)
            asked = asked_share(flight.log, rotor, onset, start)
            is_asked = asked is not None and asked < STANDS
            least = STANDS_FOR if asked is not None and not is_asked else STOPS_FOR
            if end - start < max(least, 1.5 / sensor.rate):
                continue
            if _flies_on(flight, Interval(onset - 1.0 / sensor.rate, onset)):
                if not is_asked:  # else it slows down as it is told
                    yield _speed_absent(sensor, rotor, onset, end)
                break
            speed, rest = float(speeds[run, rotor].mean()), float(others[run].mean())
            said = [f"it turns at {speed:.0f} rad/s while the others turn at {rest:.0f} rad/s"]
            if asked is None:
                said.append("whether it was told to is not logged")
            else:
                share = f"{100 * asked:.0f} % of what the others are asked for"
                said.append(f"as it slows down, it is asked for {share}")
            probability = UNASKED if asked is None else (ASKED if is_asked else CERTAIN)
            yield make_found(
                *("rotor", str(rotor + 1), "off", onset),
                end_s=None if end > float(sensor.time[there][-1]) - STANDS_FOR else end,
                size=1.0 - (speed / rest) ** 2,
                unit="1",
                probability=probability,
                ambiguous_with=() if probability == CERTAIN else ("command",),
                evidence=tuple(said),
                curve=speed_curve(sensor),
            )
            break


def _flies_on(flight: Flight, moment: Interval) -> bool:
    """Whether a vehicle turns, at each moment of a span, as it did before: then no rotor has stopped."""
    if flight.gyro is None:
        return False
    time = flight.gyro[1].time
    rates = Signal(time, np.nan_to_num(flight.gyro[1].value[:, :2]))
    flying = time[flight.in_flight(time) & (time < moment.start)]
    if len(flying) < 20 or moment.end + TURNS_IN > float(time[-1]):
        return False
    step = 0.5 * TURNS_IN
    usual, then = (np.arange(*span, step) for span in ((flying[0], moment.start - TURNS_IN), moment))
    usual, then = (
        np.linalg.norm(rates.at(at + TURNS_IN) - rates.at(at), axis=1)
        for at in (usual, np.append(then, moment.end))
    )
    return len(usual) > 3 and bool(then.max() <= usual.max())


def _speed_absent(sensor: Signal, rotor: int, onset: float, end: float) -> Found:
    said = "it reads next to nothing, and the vehicle flies on as before: no rotor has stopped"
    curve, name = speed_curve(sensor), ("speed sensor", str(rotor + 1), "absent")
    return make_found(*name, onset, curve=curve, end_s=end, evidence=(said,))


def speed_curve(sensor: Signal) -> Curve:
    """Return the measured speeds (n, rotors) as a curve."""
    lines = {f"rotor {k + 1}": sensor.value[:, k] for k in range(sensor.value.shape[1])}
    return Curve("speed of the rotors", "rad/s", sensor.time, lines)


def _slows_down(time: Floats, speed: Floats, row: int) -> float:
    """Return when [s] the fall of a speed begins that ends below a limit at a row."""
    reach = max(1, round(STEP / float(np.median(np.diff(time)))))
    first = int(np.searchsorted(time, float(time[row]) - FALL))
    part = speed[first : row + reach + 1]
    if len(part) <= 2 * reach:
        return float(time[row])
    fall = part[:-reach] - part[reach:]  # over the samples that follow
    steepest = int(np.argmax(fall))
    slow = np.flatnonzero(fall[:steepest] < SLOWS * fall[steepest])
    begins = int(slow[-1]) + 1 if len(slow) else 0
    return float(time[first + begins + reach])


def asked_share(log: FlightLog, rotor: int, start: float, end: float) -> float | None:
    """Mean command of a rotor over that of the others, or the last one; None where it is not logged."""
    commands = log.rotor_commands
    if commands is None or commands.value.shape[1] <= rotor:
        return None
    first, last = np.searchsorted(commands.time, (start, end), side="right")
    part = commands.value[max(min(first, last - 1), 0) : last]
    own, others = part[:, rotor], np.delete(part, rotor, axis=1)
    own, others = own[np.isfinite(own)], others[np.isfinite(others)]
    if not len(own) or not len(others):
        return None
    return float(own.mean() / max(float(others.mean()), 1e-9))


def _weak_found(flight: Flight, weak: Weak, has_baseline: bool) -> Found:
    thrusts = rotor_thrusts(flight.log)
    assert thrusts is not None  # there is a trim
    name, sensor = thrusts
    against = "against the healthy flight" if has_baseline else "against equal rotors"
    number = weak.rotor + 1
    said = [
        f"to hold the vehicle level takes {100 * weak.more:.0f} % more of this rotor"
        f" ({name}, {against}); this explains {np.sqrt(weak.score):.1f} standard deviations"
    ]
    if not has_baseline:
        said.append("a centre of mass off the middle looks much the same: a healthy flight settles it")
    others = tuple(f"rotor/{k + 1}" for k in weak.others)
    found = make_found(
        *("rotor", str(number), "off" if weak.loss > ALL_OF_IT else "loss", flight.intervals[0].start),
        size=weak.loss,
        sigma=weak.sigma,
        unit="1",
        probability=confidence(weak.score, SHARPER) * weak.probability * (1.0 if has_baseline else 0.6),
        ambiguous_with=others if has_baseline else (*others, "centre of mass"),
        evidence=tuple(said),
    )
    flying = flight.in_flight(sensor.time)
    shares = sensor.value[flying] / np.maximum(row_means(sensor.value)[flying], 1e-9)
    lines = {f"rotor {k + 1}": share for k, share in enumerate(shares.T)}
    return found._replace(curve=Curve("share of each rotor", "1", sensor.time[flying], lines))
