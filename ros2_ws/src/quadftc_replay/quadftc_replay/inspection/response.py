"""A vehicle that answers its commands the wrong way from take-off on, with sensors and rotors all sound.

Motors in the wrong order, propellers on the wrong way, a reversed axis or an autopilot that is turned change
how commands turn the vehicle. With the layout B (rows roll, pitch, yaw, each of length 1), commands u behind
the rotors' lag T, and a wiring E, the body rate since the vehicle began to turn is

    omega(t) = int g E u_T + c mean(u_T) dt,    g >= 0

g is one gain of roll and pitch, and one of yaw that is no larger. c is what turns the vehicle besides, in
proportion to the thrust: of a sound vehicle (E = B) anything at all, such as the ground, an obstacle or a
push; of one that is wired otherwise no more than a centre of mass off the middle. E = B without the column of
rotor i is a rotor that gives no thrust.

A vehicle that turns over as it takes off has shown only this motion. A wiring has to explain nearly all of
it, and far more than a sound vehicle that has lost a rotor, or is pushed. On the ground a rotor that does
not start, or a foot that is caught, may look the same; then it is named as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.ending import UPSET, tilt_of
from quadftc_replay.inspection.flight import (
    FLYING,
    HELD,
    SPINNING,
    TAKE_OFF,
    Flight,
    Interval,
    lies_still,
    rotor_level,
    row_means,
)
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.identification import FINE, LAGS, STANDS, bin_means, lagged
from quadftc_replay.inspection.rotor_step import ASIDE, FASTEST, fast_commands
from quadftc_replay.inspection.rotor_trim import BETWEEN_VEHICLES, effects
from quadftc_replay.inspection.rotors import asked_share, speed_curve
from quadftc_replay.inspection.whitening import Floats

AXES = ("roll", "pitch", "yaw")
BEGINS = 0.1  # 1; of its greatest rate, at which the vehicle begins to turn
SETTLES = 0.6  # s; of commands before, for the lag: four of the longest lag
FEWEST = 4  # samples of the gyro
LEFT = 0.001  # 1; of the motion, that no model explains: commands are known ten times a second
EXPLAINS = 0.99  # 1; of the motion, that a wiring has to explain, or
MOST = 0.9  # 1; of what a sound vehicle leaves of it
BETTER = 2.0  # 1; times as much that a sound vehicle leaves
HALF = 0.5  # 1; of what an axis answers, that turns the vehicle about another one
ALIKE = 1.0 - ASIDE**2  # 1; of the motion, from which a lost rotor is named as well
ALONG = 0.7  # 1; cosine of 45 deg: an axis that answers less along itself answers the wrong way
TURN = 2.0 * np.pi  # rad; of yaw, by which a vehicle spins
TRIM = 2.0 * float(BETWEEN_VEHICLES[0])  # 1; of the thrust: two standard deviations


class Motion(NamedTuple):
    """What is known of a vehicle that turns over at take-off; n samples, after the first."""

    time: Floats  # (n,) [s]
    turned: Floats  # (n, 3) change of the body rate since the first [rad/s]
    commands: Mapping[float, Floats]  # lag [s]: integral of each rotor's command behind it (n, rotors) [s]


class Fit(NamedTuple):
    """What a wiring explains of a motion."""

    share: float  # 1; of the sum of squares
    left: float  # 1; the rest, with what no model explains


class Wiring(NamedTuple):
    """A wiring that explains the motion, and what else does."""

    said: str  # the likeliest, and the next that explains nearly as much
    wrong: tuple[int, ...]  # axes that answer the wrong way, whichever wiring it is
    is_turned: bool  # whether a command turns the vehicle about another axis
    score: float  # 1; times as much that a sound vehicle leaves
    others: tuple[str, ...]  # what looks much the same


def response_findings(flight: Flight) -> list[Found]:
    """Say of a vehicle that turns over or spins at take-off whether it answers its commands the wrong way."""
    layout, places = effects(flight.log), flight.log.rotor_positions
    if layout is None or places is None:
        return []
    for span, find in ((turning_over(flight), find_wiring), (spinning(flight), yaw_reversed)):
        if span is None:
            continue
        if (stands := _rotor_that_stands(flight, span)) is not None:
            return [_standing_found(flight, span, stands)]
        motion = motion_of(flight, span)
        if motion is None or motion.commands[0.0].shape[1] != layout.shape[1]:
            continue
        if (wiring := find(motion, layout, places)) is not None:
            return [_found(flight, span, wiring)]
    return []


def turning_over(flight: Flight) -> Interval | None:
    """Return from when to when a vehicle turns ever faster until it lies on its side, at take-off."""
    log, level = flight.log, rotor_level(flight.log)
    if log.attitude is None or level is None or len(log.attitude) < 2:
        return None
    time, thrust = log.attitude.time, np.nan_to_num(level.value[:, 0])
    tilt = tilt_of(log.attitude)
    for k in np.flatnonzero((tilt[1:] > UPSET) & (tilt[:-1] <= UPSET)).tolist():
        over = float(np.interp([UPSET], tilt[k : k + 2], time[k : k + 2])[0])
        before = thrust[(level.time > over - TAKE_OFF) & (level.time <= over)]
        if not len(before) or before[-1] < SPINNING * thrust.max():
            continue
        low = level.time[(level.time <= over) & (thrust < SPINNING * before.max())]
        return _growing(flight, float(low[-1]), over) if len(low) else None
    return None


def spinning(flight: Flight) -> Interval | None:
    """Return from when to when a vehicle spins ever faster until a whole turn, at take-off, upright."""
    level = rotor_level(flight.log)
    if level is None or flight.gyro is None:
        return None
    thrust = np.nan_to_num(level.value[:, 0])
    on = thrust > SPINNING * thrust.max()
    low = thrust < FLYING * float(np.median(thrust[on])) if on.any() else ~on
    rises = np.flatnonzero(low[:-1] & ~low[1:])
    if not len(rises):
        return None
    start = float(level.time[rises[0]])
    turn = flight.gyro[1].integral()
    turned = np.abs(turn.value[:, 2] - np.interp(start, turn.time, turn.value[:, 2]))
    whole = np.flatnonzero((turn.time > start) & (turned > TURN))
    span = _growing(flight, start, float(turn.time[whole[0]])) if len(whole) else None
    attitude = flight.log.attitude
    if span is None or attitude is None or not len(attitude):
        return span
    return None if np.any(tilt_of(attitude)[attitude.time <= span.end] > UPSET) else span


def _growing(flight: Flight, start: float, end: float) -> Interval | None:
    """Return from when to when a vehicle turns ever faster in a span [s]; None: it flew before."""
    if flight.gyro is None:
        return None
    time = flight.gyro[1].time
    size = np.linalg.norm(np.nan_to_num(flight.gyro[1].value), axis=1)
    first, last = np.searchsorted(time, (start, end), side="right").tolist()
    if last - first < FEWEST:
        return None
    fastest = first + int(np.argmax(size[first:last]))
    slow = np.flatnonzero(size[first : fastest + 1] < BEGINS * size[fastest])
    begin = float(time[first + int(slow[-1]) if len(slow) else first])
    return Interval(begin, float(time[fastest])) if _takes_off(flight, begin) else None


def _takes_off(flight: Flight, moment: float) -> bool:
    """Whether the rotors were slow shortly before a moment [s], or the ground held the vehicle."""
    level = rotor_level(flight.log)
    if level is None:
        return False
    rows = slice(*np.searchsorted(level.time, (moment - TAKE_OFF, moment)))
    share = level.value[rows, 0] / max(float(level.at(np.array([moment]))[0, 0]), 1e-9)
    held = (share < 1.0 - HELD) & lies_still(flight.log, level.time[rows])
    return bool(np.any((share < FLYING) | held))


def _rotor_that_stands(flight: Flight, span: Interval) -> int | None:
    """Return the rotor that stands all along by its measured speed, though it is told to turn; None: none."""
    speeds = flight.log.rotor_speeds
    part = None if speeds is None else speeds.value[slice(*np.searchsorted(speeds.time, span))]
    if part is None or not len(part):
        return None
    part = np.abs(np.nan_to_num(part))
    stands = np.all(part < STANDS * np.median(part, axis=1, keepdims=True), axis=0)
    for rotor in np.flatnonzero(stands).tolist():
        asked = asked_share(flight.log, rotor, *span)
        if asked is None or asked >= STANDS:
            return rotor
    return None


def _standing_found(flight: Flight, span: Interval, rotor: int) -> Found:
    speeds = flight.log.rotor_speeds
    assert speeds is not None  # else no rotor is known to stand
    said = f"it stands as the vehicle takes off and turns, from {span.start:.2f} to {span.end:.2f} s"
    curve = speed_curve(speeds)
    return make_found("rotor", str(rotor + 1), "off", span.start, curve=curve, evidence=(said,))


def motion_of(flight: Flight, span: Interval) -> Motion | None:
    """Put the body rate and the commands of a span together; None where one is missing or too short."""
    commands = fast_commands(flight.log)
    if commands is None or flight.gyro is None:
        return None
    gyro = flight.gyro[1]
    stride = max(1, round(gyro.rate / FASTEST))
    first, last = np.searchsorted(gyro.time, span).tolist()
    rows = slice(first, last + 1, stride)
    time, value = gyro.time[rows], np.nan_to_num(gyro.value[rows])
    if len(time) <= FEWEST:
        return None
    edges = np.arange(time[0] - SETTLES, time[-1] + 2.0 / FINE, 1.0 / FINE)
    driven = np.nan_to_num(bin_means(edges, commands, hold=False))
    integrals = dict[float, Floats]()
    for lag in LAGS.tolist():
        total = np.cumsum(lagged(driven, lag, 1.0 / FINE), axis=0) / FINE
        at = Signal(edges[1:], total).at(time)
        integrals[lag] = at[1:] - at[0]
    return Motion(time[1:], value[1:] - value[0], integrals)


def wirings(layout: Floats, places: Floats) -> dict[str, Floats]:
    """Return the layouts (3, rotors) of a vehicle that is wired otherwise, by what is wrong with it."""
    found = {"": layout}

    def add(name: str, wired: Floats) -> None:
        if not any(np.allclose(wired, each, atol=1e-6) for each in found.values()):
            found[name] = wired

    for name, turned in _turns():
        for sign, more in ((1.0, ""), (-1.0, "yaw reversed")):
            matrix = np.eye(3)
            matrix[:2, :2], matrix[2, 2] = turned, sign
            add(" and ".join(filter(None, (name, more))), matrix @ layout)
    for name, order in _orders(places):
        wired = np.empty_like(layout)
        wired[:, order] = layout
        add(name, wired)
    return found


def _turns() -> Iterator[tuple[str, Floats]]:
    """What roll and pitch may be exchanged for: reversals and turns of the autopilot."""
    yield "", np.eye(2)
    yield "roll reversed", np.diag([-1.0, 1.0])
    yield "pitch reversed", np.diag([1.0, -1.0])
    yield "roll and pitch reversed, or the autopilot turned by 180 deg", -np.eye(2)
    yield "the autopilot turned by 90 deg", np.array([[0.0, -1.0], [1.0, 0.0]])
    yield "the autopilot turned by -90 deg", np.array([[0.0, 1.0], [-1.0, 0.0]])
    yield "roll and pitch exchanged", np.array([[0.0, 1.0], [1.0, 0.0]])
    yield "roll and pitch exchanged and reversed", np.array([[0.0, -1.0], [-1.0, 0.0]])


def _orders(places: Floats) -> Iterator[tuple[str, list[int]]]:
    """Orders of motors: of each the number of the command that drives it."""
    count = len(places)
    for k in range(count):
        for other in range(k + 1, count):
            order = list(range(count))
            order[k], order[other] = other, k
            yield f"motors {k + 1} and {other + 1} exchanged", order
    around = np.argsort(np.arctan2(places[:, 1], places[:, 0]))
    for step in (1, -1):
        moved = np.arange(count)
        moved[around] = np.roll(around, step)
        yield "each motor in the place of the next", moved.tolist()


def explain(motion: Motion, layout: Floats, trim: float) -> Fit:
    """Fit gains to a layout (3, rotors); ``trim`` bounds what turns the vehicle besides, over the gain."""
    total = float(np.sum(motion.turned**2))
    least = min(_left(motion.turned, drive, layout, trim) for drive in motion.commands.values())
    share = 1.0 - least / max(total, 1e-12)
    return Fit(share, 1.0 - share + LEFT)


def _left(turned: Floats, drive: Floats, layout: Floats, trim: float) -> float:
    """Sum of squares of a motion (n, 3) that drives (n, rotors) leave."""
    asked, mean = drive @ layout.T, row_means(drive)
    along = mean / max(float(np.linalg.norm(mean)), 1e-12)
    flat, goal = asked[:, :2], turned[:, :2]
    gain = _gain(flat - along @ (along.T @ flat), goal - along @ (along.T @ goal))
    push = along.T @ (goal - gain * flat) / max(float(np.linalg.norm(mean)), 1e-12)  # (1, 2)
    size = float(np.linalg.norm(push))
    if size > trim * gain:
        flat = flat + mean * (trim * push / max(size, 1e-12))
        gain = _gain(flat, goal)
        rest = goal - gain * flat
    else:
        rest = goal - gain * flat - mean * push
    yaw = min(_gain(asked[:, 2:], turned[:, 2:]), gain)
    return float(np.sum(rest**2) + np.sum((turned[:, 2:] - yaw * asked[:, 2:]) ** 2))


def _gain(asked: Floats, turned: Floats) -> float:
    """The gain, never negative, by which what is asked for best explains what comes."""
    return max(float(np.sum(asked * turned)) / max(float(np.sum(asked**2)), 1e-12), 0.0)


def find_wiring(motion: Motion, layout: Floats, places: Floats) -> Wiring | None:
    """Find how a vehicle is wired that turns as it should not; None: nothing says that it is."""
    known = wirings(layout, places)
    answers = {name: np.diag(wired @ np.linalg.pinv(layout)) for name, wired in known.items()}
    fits = {name: explain(motion, wired, TRIM) for name, wired in known.items()}
    tilts = {name: fit for name, fit in fits.items() if not np.allclose(known[name][:2], layout[:2])}
    best = min(tilts.values(), key=lambda each: each.left)
    losses = [explain(motion, _without(layout, k), TRIM) for k in range(layout.shape[1])]
    pushed = explain(motion, layout, np.inf)
    others = [fit for name, fit in fits.items() if name not in tilts]
    sound = min(each.left for each in (pushed, *losses, *others))
    if not _is_explained(best.left, sound):
        return None
    alike = sorted(
        (name for name in tilts if fits[name].left < BETTER * best.left), key=lambda name: fits[name].left
    )
    own = np.array([answers[name] for name in alike])  # (m, 3)
    common = np.all(own < ALONG, axis=0)
    wrong = np.flatnonzero(common if common.any() else own[0] < ALONG)
    tilting = wrong[wrong < 2] if np.any(wrong < 2) else wrong
    rotor = int(np.argmin([each.left for each in losses]))
    likewise = (f"rotor/{rotor + 1}",) if losses[rotor].share > ALIKE else ()
    if _held_by_ground(motion, layout) < BETTER * best.left:
        likewise = (*likewise, "held by the ground")
    return Wiring(
        said=", or ".join(alike[:2]),
        wrong=tuple(wrong.tolist()),
        is_turned=bool(np.all(own[0, tilting] > -HALF)),
        score=sound / best.left,
        others=likewise,
    )


def _held_by_ground(motion: Motion, layout: Floats) -> float:
    """Share of a motion that a sound vehicle leaves which the ground, or what it is caught in, turns over.

    That turns it in proportion to the thrust beyond some level: its push is a + c mean(u), any a and c.
    """
    elapsed = np.arange(1.0, len(motion.time) + 1.0)  # samples of the gyro
    total, left = max(float(np.sum(motion.turned**2)), 1e-12), list[float]()
    for drive in motion.commands.values():
        pushes = np.linalg.qr(np.column_stack([row_means(drive), elapsed]))[0]
        asked, turned = (
            each - pushes @ (pushes.T @ each) for each in ((drive @ layout.T)[:, :2], motion.turned[:, :2])
        )
        gain = _gain(asked, turned)
        yaw = motion.turned[:, 2] - gain * (drive @ layout[2])
        left.append(float(np.sum((turned - gain * asked) ** 2) + np.sum(yaw**2)))
    return min(left) / total + LEFT


def _is_explained(left: float, sound: float) -> bool:
    """Whether a wiring leaves little enough of the motion, against what a sound vehicle leaves."""
    is_little = left < 1.0 - EXPLAINS + LEFT or left < (1.0 - MOST) * sound
    return is_little and sound > BETTER * left


def yaw_reversed(motion: Motion, layout: Floats, _places: Floats) -> Wiring | None:
    """Say whether a vehicle spins against its command, as no rotor that is lost makes it."""
    turned = motion.turned[:, 2:]
    square = max(float(np.sum(turned**2)), 1e-12)

    def left(row: Floats, is_pushed: bool = False) -> float:
        """Share of the spin that a row of a layout (rotors,) leaves, behind the best lag."""
        least = min(_left_of_yaw(turned, drive, row, is_pushed) for drive in motion.commands.values())
        return LEFT + least / square

    row = layout[2]
    best, sound = left(-row), left(row)
    losses = [left(_without(layout, k)[2]) for k in range(len(row))]
    total = motion.commands[0.0][-1]  # over the spin
    trim = float(np.linalg.norm(layout[:2] @ total)) / max(float(total.mean()), 1e-9)
    if not _is_explained(best, min(sound, *losses)) or trim > TRIM:  # which a weak rotor takes to stay level
        return None
    pushed = left(row, is_pushed=True)
    others = () if pushed > BETTER * best else ("a rotor that is not upright",)
    return Wiring("yaw reversed", (2,), False, min(sound, *losses) / best, others)


def _left_of_yaw(turned: Floats, drive: Floats, row: Floats, is_pushed: bool) -> float:
    """Sum of squares of a spin (n, 1) that a row of a layout leaves, with or without a push."""
    asked, mean = drive @ row[:, None], row_means(drive)
    if is_pushed:
        along = mean / max(float(np.linalg.norm(mean)), 1e-12)
        asked, turned = asked - along @ (along.T @ asked), turned - along @ (along.T @ turned)
    return float(np.sum((turned - _gain(asked, turned) * asked) ** 2))


def _without(layout: Floats, rotor: int) -> Floats:
    """A layout (3, rotors) without a rotor."""
    left = layout.copy()
    left[:, rotor] = 0.0
    return left


def _found(flight: Flight, span: Interval, wiring: Wiring) -> Found:
    assert flight.gyro is not None  # else there is no span
    gyro = flight.gyro[1]
    said = (
        f"from {span.start:.2f} to {span.end:.2f} s it turns as with {wiring.said}:"
        f" a sound vehicle that is pushed, or lacks a rotor, leaves {wiring.score:.1f} times as much of it",
        "check the order of the motors, the sense of the propellers, and how the autopilot is mounted",
    )
    lines = {f"body rate, {name}": gyro.value[:, k] for k, name in enumerate(AXES)}
    return make_found(
        *("response", ",".join(AXES[k] for k in wiring.wrong)),
        *("exchanged" if wiring.is_turned else "reversed", span.start),
        probability=confidence(wiring.score, BETTER),
        ambiguous_with=wiring.others,
        evidence=said,
        curve=Curve("body rate", "rad/s", gyro.time, lines),
    )
