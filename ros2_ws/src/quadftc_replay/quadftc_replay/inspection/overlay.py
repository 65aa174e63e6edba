"""Faults put on the signals of a log; times count from the first sample of the log.

A fault acts on the main sensor of its channel; one of channel ``imu`` on all three.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_replay.flight_log import FlightLog, Floats, Signal
from quadftc_replay.inspection.flight import Flight, prepare
from quadftc_replay.overlay import OverlaidFault
from quadftc_sim.fault import FaultInputs
from quadftc_sim.injection import Injection, fault_generators

CHANNELS = ("gyro", "accelerometer", "attitude")


def overlay_faults(log: FlightLog, faults: Sequence[OverlaidFault], seed: int = 0) -> FlightLog:
    """Put faults on a log; a ValueError says which one cannot act."""
    flight = prepare(log)
    for number, fault in enumerate(faults, 1):
        injection = fault.injection
        if injection.start >= log.end:
            bound = f"must be before the end of the log, {log.end:.3f} s"
            raise ValueError(f"fault '{fault.said}': start = {injection.start:g} s: {bound}")
        channels = CHANNELS if injection.channel == "imu" else (injection.channel,)
        there = [channel for channel in channels if _signal(flight, channel) is not None]
        if not there:
            raise ValueError(f"fault '{fault.said}': {log.path.name} has no {injection.channel}")
        for channel in there:
            log = _with_fault(prepare(log), channel, injection, seed, number)
    return log


def _signal(flight: Flight, channel: str) -> Signal | None:
    if channel == "attitude":
        return flight.log.attitude
    if channel == "gyro":
        return flight.gyro[1] if flight.gyro is not None else None
    return next(iter(flight.log.accelerometers.values()), None)


def _with_fault(flight: Flight, channel: str, injection: Injection, seed: int, number: int) -> FlightLog:
    log, signal = flight.log, _signal(flight, channel)
    assert signal is not None
    is_attitude = channel == "attitude"
    values = euler_from_quaternion(signal.value) if is_attitude else signal.value
    faulty, there = _apply(injection, signal.time, values, seed, number)
    if is_attitude:
        acts = np.any(faulty != values, axis=1, keepdims=True)
        faulty = np.where(acts, quaternion_from_euler(faulty), signal.value)
    changed = Signal(signal.time, np.where(there[:, None], faulty, np.nan))
    if is_attitude:
        return dataclasses.replace(log, attitude=changed)
    if channel == "accelerometer":
        name = next(iter(log.accelerometers))
        return dataclasses.replace(log, accelerometers={**log.accelerometers, name: changed})
    if flight.rate_is_estimated:
        return dataclasses.replace(log, body_rate=changed)
    assert flight.gyro is not None
    return dataclasses.replace(log, gyros={**log.gyros, flight.gyro[0]: changed})


def _apply(
    injection: Injection, time: Floats, values: Floats, seed: int, number: int
) -> tuple[Floats, np.ndarray]:
    """Return the faulty values (n, 3), and which samples are there (n,)."""
    law, zeros = injection.law, np.zeros(3)
    faulty, there = values.copy(), np.ones(len(time), np.bool_)
    end = int(np.searchsorted(time, injection.stop))
    first = 0 if law.has_memory else int(np.searchsorted(time, injection.start))
    if first >= end:
        return faulty, there
    state = law.init(values[first])
    normal, uniform = fault_generators(seed, number)
    last = float(time[max(first - 1, 0)])
    for row in range(first, end):
        now = float(time[row])
        draws = (normal.standard_normal(3), uniform.random(3)) if law.is_random else (zeros, zeros)
        state, output = law.step(
            state, FaultInputs(values[row], np.float64(now - injection.start), *draws), now - last
        )
        last = now
        if now >= injection.start:
            faulty[row] = np.where(injection.mask, output.value, values[row])
            there[row] = bool(output.valid)
    return faulty, there
