"""How a flight ends: landed, switched off in the air, flown into the ground, out of control, or with the log.

A vehicle is out of control when it tilts beyond `UPSET` and, while it does, an output is at its limit against
its opposite, or it turns against the torque that is asked for, or an impact follows.
"""

from __future__ import annotations

import numpy as np

from quadftc_model.rotations import earth_z_in_body
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight, rotor_level, row_means
from quadftc_replay.inspection.rotor_step import torque_of
from quadftc_replay.inspection.verdict import Ending, EndKind
from quadftc_replay.inspection.whitening import Floats, Mask, runs_of

UPSET = np.radians(60.0)  # tilt
LASTS = 0.2  # s; of the tilt
SOON = 10.0  # s; from upset to impact
ASKED = 0.2  # 1; share of the thrust that makes a torque which a vehicle has to follow
AT_LIMIT = 0.95  # 1; of the range of an output
STOPPED = 0.3  # 1; of the usual thrust, below which a multirotor falls
FALLS = 3.0  # m/s; no landing is that fast
FALLING = 0.6  # 1; of gravity, felt by a vehicle that falls
BEFORE = 3.0  # s; in which a vehicle falls before an impact


def ending_of(flight: Flight) -> Ending:
    """Say how a flight ended."""
    log, impact = flight.log, flight.crash
    hit = "" if impact is None else f"; impact at {impact:.2f} s"
    upset = upset_at(flight)
    off = _stopped_at(flight, impact)
    if off is not None and (upset is None or off < upset) and _falls(log, off, impact):
        said = f"the rotors were stopped in the air at {off:.2f} s{hit}"
        return _ending("switched off in the air", off, impact, said)
    if upset is not None:
        return _ending("out of control", upset, impact, f"out of control from {upset:.2f} s{hit}")
    stops = _stopped_at(flight, None)
    if stops is not None and impact is not None and abs(stops - impact) > BEFORE:
        stops = None
    fall = None if impact is None else _fall_before(log, impact)
    if impact is not None and (stops is None or (fall is not None and fall > FALLS)):
        at = "" if fall is None or round(fall) < 1 else f" at {fall:.0f} m/s"
        return _ending("hit the ground", impact, impact, f"it hit the ground{at} at {impact:.2f} s")
    if stops is not None:
        return _ending("landed", stops, impact, f"it landed and stopped its rotors at {stops:.2f} s")
    return _ending("in flight", log.end, None, "the log ends in flight")


def _ending(kind: EndKind, time: float, impact: float | None, said: str) -> Ending:
    return Ending(kind=kind, time_s=time, impact_s=impact, sentence=said)


def upset_at(flight: Flight) -> float | None:
    """Return when the vehicle goes out of control [s]; None: it does not, or nobody knows."""
    log = flight.log
    if log.attitude is None:
        return None
    time = log.attitude.time
    tilt = tilt_of(log.attitude)
    before_impact = time <= (np.inf if flight.crash is None else flight.crash)
    for run in runs_of((tilt > UPSET) & before_impact & _powered(flight, time)):
        start, end = float(time[run.start]), float(time[run.stop - 1])
        crashes = flight.crash is not None and flight.crash - start < SOON
        if crashes or (end - start >= LASTS and _at_limits(log.rotor_commands, start - LASTS, end)):
            return start
        if end - start >= LASTS and _turns_against(flight, start - SOON, end):
            return start
    return None


def tilt_of(attitude: Signal) -> Floats:
    """Tilt of each sample of an attitude (n,) [rad]."""
    return np.arccos(np.clip(earth_z_in_body(attitude.value)[..., 2], -1.0, 1.0))


def _powered(flight: Flight, time: Floats) -> Mask:
    """Whether the rotors carry the vehicle, or nobody knows (n,): a vehicle is turned over by hand, too."""
    level = rotor_level(flight.log)
    if level is None or not flight.phases_known:
        return np.ones(len(time), np.bool_)
    flying = flight.in_flight(level.time)
    usual = float(np.nanmedian(level.value[flying, 0])) if flying.any() else 0.0
    return np.interp(time, level.time, np.nan_to_num(level.value[:, 0])) > STOPPED * usual


def _at_limits(commands: Signal | None, start: float, end: float) -> bool:
    """Whether, at some time, one rotor is asked for all and another for nothing."""
    if commands is None:
        return False
    part = commands.value[slice(*np.searchsorted(commands.time, (start, end)))]
    if not len(part):
        return False
    return bool(np.any((np.nanmax(part, axis=1) > AT_LIMIT) & (np.nanmin(part, axis=1) < 1.0 - AT_LIMIT)))


def _turns_against(flight: Flight, start: float, end: float) -> bool:
    """Whether the vehicle turns ever faster against the torque that is asked for."""
    torque = torque_of(flight)
    if torque is None:
        return False
    alpha, rate = torque.columns[..., 0], torque.columns[..., 2]
    against = np.linalg.norm(torque.asked, axis=1) > ASKED
    against &= (np.sum(torque.asked * alpha, axis=1) < 0.0) & (np.sum(torque.asked * rate, axis=1) < 0.0)
    against &= (torque.time > start) & (torque.time < end)
    runs = runs_of(against)
    return any(float(torque.time[run.stop - 1] - torque.time[run.start]) >= LASTS for run in runs)


def _stopped_at(flight: Flight, impact: float | None) -> float | None:
    """Return when the rotors stop for good, before an impact [s]; None, too, if they are asked to turn."""
    level = rotor_level(flight.log)
    if level is None or not flight.phases_known or not len(level):
        return None
    flying = flight.in_flight(level.time)
    usual = float(np.nanmedian(level.value[flying, 0])) if flying.any() else 0.0
    low = np.nan_to_num(level.value[:, 0]) < 0.1 * STOPPED * usual
    last = min(float(level.time[-1]), np.inf if impact is None else impact)
    before = level.time <= last
    if not before.any() or not low[before][-1]:
        return None
    up = np.flatnonzero(~low[before])
    if not len(up) or up[-1] + 1 >= len(level):
        return None
    stops = float(level.time[up[-1] + 1])
    return None if _asked(flight, stops) > STOPPED else stops


def _asked(flight: Flight, moment: float) -> float:
    """Mean command of the rotors at a moment [s], over the usual one; 0: none is logged."""
    commands = flight.log.rotor_commands
    if commands is None or not len(commands):
        return 0.0
    mean = np.nan_to_num(row_means(commands.value)[:, 0])
    flying = flight.in_flight(commands.time)
    usual = float(np.median(mean[flying])) if flying.any() else np.inf
    return float(np.interp(moment, commands.time, mean)) / max(usual, 1e-9)


def _falls(log: FlightLog, moment: float, impact: float | None) -> bool:
    """Whether the vehicle falls after a moment [s]: by its speed, else by the force that it feels."""
    if impact is None and log.end - moment > BEFORE:  # nothing falls for so long
        return False
    speed = log.velocity or log.gps_velocity
    if speed is not None and len(speed) > 1 and speed.time[-1] > moment:
        after = (speed.time > moment) & (speed.time < moment + BEFORE)
        return bool(after.any() and float(speed.value[after, 2].min()) < -FALLS)
    force = next(iter(log.accelerometers.values()), None)
    if force is None:
        return False
    after = (force.time > moment) & (force.time < moment + 0.3 * BEFORE)
    felt = np.linalg.norm(force.value[after], axis=1)
    return bool(len(felt) and float(np.median(felt)) < FALLING * STANDARD_GRAVITY)


def _fall_before(log: FlightLog, impact: float) -> float | None:
    """Return the greatest speed of descent before an impact [m/s]."""
    speed = log.velocity or log.gps_velocity
    if speed is None:
        return None
    before = (speed.time > impact - BEFORE) & (speed.time < impact)
    return float(-speed.value[before, 2].min()) if before.any() else None
