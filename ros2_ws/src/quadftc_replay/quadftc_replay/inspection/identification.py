"""A model of the vehicle from its own log: angular acceleration from what drives it.

    alpha = G u_T + d,    T u_T' = u - u_T

u is what drives: rotor speeds squared, rotor commands, or commanded torque; T is the rotors' lag, d is slow.
Least squares on what is between `BAND`, where slow disturbances and vibration are weak. Blocks of a second
with a large residual weigh less, so that the stretch after a fault hardly counts. T is searched for. Gains
that the log does not excite stay at zero. Rotors together have next to none whatever the log says: climbs and
turns that go together would give them some.

All signals are means over the bins of one grid; they need no equal sampling. R² is what a fit to every other
block explains of the blocks between. The rows of G for roll and pitch tell where the rotors are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import signal

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.whitening import Floats, Mask

FINE = 500.0  # Hz; of the bins, or the rate of the gyro if that is less
KEPT = 125.0  # Hz; of what is left of them behind the filter
BAND = (1.0, 15.0)  # Hz; no more than 40 % of half the rate of the bins; below, gusts drive the rotors
LAGS = np.array([0, 5, 10, 15, 20, 30, 40, 50, 60, 70, 85, 100, 120, 150]) * 1e-3  # s
BLOCK = 1.0  # s
ROUNDS = 4  # of the reweighted fit
RIDGE = 3e-3  # 1; of the mean power of the inputs: where a log excites them less, gains stay at zero
TOGETHER = 30.0  # 1; as much again for all rotors together, which hardly turn a vehicle
USABLE = 0.2  # 1; R² of an axis from which it is used
SLOWEST = 25.0  # Hz; of gyro and inputs
LEAST = 4  # blocks
FEWEST = 20  # samples of what drives
STANDS = 0.25  # 1; of the usual speed, below which a rotor stands or its sensor is out


class Identified(NamedTuple):
    """The model; columns are roll, pitch, yaw."""

    source: str  # rotor_speeds, rotor_commands or torque_command
    lag: float  # s
    gain: Floats  # (k, 3) per unit of input
    r2: Floats  # (3,) of the blocks that were not fitted

    @property
    def usable(self) -> Mask:
        """Whether the log excites each axis enough (3,)."""
        return self.r2 > USABLE


def drive_of(log: FlightLog) -> tuple[str, Signal] | None:
    """Return what drives the vehicle (n, k) and what it is called; None: not logged, or too slow.

    Speeds are squared, and a half is usual; of rotors that stand nothing is known.
    """
    squares, speeds = None, log.rotor_speeds
    if speeds is not None and np.any(speeds.value > 0.0):
        usual = float(np.nanmedian(speeds.value[speeds.value > 0.0]))
        turning = np.where(speeds.value > STANDS * usual, speeds.value / usual, np.nan)
        squares = Signal(speeds.time, 0.5 * turning**2)
    named = (
        ("rotor_speeds", squares),
        ("rotor_commands", log.rotor_commands),
        ("torque_command", log.torque_command),
    )
    for name, each in named:
        if each is not None and each.rate >= SLOWEST and len(each.whole()) > FEWEST:
            return name, each
    return None


def identify(flight: Flight) -> Identified | None:
    """Fit the model; None if nothing that drives is logged, or if that is too slow or too short."""
    drive = drive_of(flight.log)
    if drive is None or flight.gyro is None or flight.gyro[1].rate < SLOWEST:
        return None
    gyro, (source, inputs) = flight.gyro[1], drive
    start, end = (pick(gyro.time[k], inputs.time[k]) for pick, k in ((max, 0), (min, -1)))
    if end - start < LEAST * BLOCK:
        return None
    # bins, of which the band is kept
    rate = min(FINE, gyro.rate)
    edges = np.arange(start, end, 1.0 / rate)
    time = 0.5 * (edges[1:] + edges[:-1])
    flying = flight.is_calm(time)
    for each in (gyro, inputs):
        flying &= _has_samples(edges, each, 3.0 / each.rate)
    alpha = np.gradient(np.nan_to_num(bin_means(edges, gyro, hold=False)), 1.0 / rate, axis=0)
    driven = np.nan_to_num(bin_means(edges, inputs, hold=True))
    bands = signal.butter(2, [BAND[0], min(BAND[1], 0.2 * rate)], "bandpass", fs=rate, output="sos")
    stride = max(1, round(rate / KEPT))
    measured, driven = (signal.sosfiltfilt(bands, each, axis=0)[::stride] for each in (alpha, driven))
    # blocks that are flown for three quarters
    dt = stride / rate
    length = round(BLOCK / dt)
    count = len(measured) // length
    flown = flying[::stride][: count * length].reshape(count, length).mean(axis=1) > 0.75
    if flown.sum() < LEAST:
        return None

    def in_blocks(values: Floats) -> Floats:
        return values[: count * length].reshape(count, length, -1)[flown]

    # the lag by which most is explained
    y, tried = in_blocks(measured), list[tuple[float, float, Floats, Floats]]()
    for lag in LAGS.tolist():
        x = in_blocks(lagged(driven, lag, dt))
        r2 = _held_out(x, y)
        tried.append((float(np.sum(np.clip(r2[:2], -1.0, 1.0))), lag, r2, x))
    _, lag, r2, x = max(tried, key=lambda each: each[0])
    return Identified(source, lag, _fit(x, y), r2)


def bin_means(edges: Floats, sensor: Signal, hold: bool) -> Floats:
    """Means over bins (n - 1, k); a signal is held from sample to sample, or goes straight between them."""
    time, value = sensor.whole()
    if len(time) < 2:
        return np.full((len(edges) - 1, value.shape[1]), np.nan)
    between = value[:-1] if hold else 0.5 * (value[:-1] + value[1:])
    total = np.cumsum(between * np.diff(time)[:, None], axis=0)
    at = Signal(time, np.concatenate([np.zeros((1, value.shape[1])), total])).at(edges)
    return np.diff(at, axis=0) / np.diff(edges)[:, None]


def _has_samples(edges: Floats, sensor: Signal, slack: float) -> Mask:
    """Whether each bin is within reach of a sample on both sides (n - 1,)."""
    time = sensor.whole().time
    if len(time) < 2:
        return np.zeros(len(edges) - 1, np.bool_)
    after = time[np.clip(np.searchsorted(time, edges[1:]), 0, len(time) - 1)]
    before = time[np.clip(np.searchsorted(time, edges[:-1], side="right") - 1, 0, len(time) - 1)]
    return (after - before < slack + (edges[1] - edges[0])) & (before <= edges[:-1]) & (after >= edges[1:])


def lagged(inputs: Floats, lag: float, dt: float) -> Floats:
    """Put the rotors' lag on inputs (n, k), settled at the first."""
    if lag <= 0.0:
        return inputs
    share = float(np.exp(-dt / lag))
    return signal.lfilter([1.0 - share], [1.0, -share], inputs, axis=0, zi=share * inputs[:1])[0]


def _held_out(x: Floats, y: Floats) -> Floats:
    """R² of each column, on blocks that were not fitted: of all, or of the usual one if that is more."""
    parity = np.arange(len(y)) % 2 == 0
    left = np.concatenate([_left(x[~each], y[~each], _fit(x[each], y[each])) for each in (parity, ~parity)])
    power = np.concatenate([np.mean(y[~each] ** 2, axis=1) for each in (parity, ~parity)])
    pooled = 1.0 - left.sum(axis=0) / np.maximum(power.sum(axis=0), 1e-12)
    return np.maximum(pooled, 1.0 - np.median(left / np.maximum(power, 1e-12), axis=0))


def _left(x: Floats, y: Floats, gain: Floats) -> Floats:
    """Mean square that gains (k, 3) leave in each block (b, 3)."""
    return np.mean((y - x @ gain) ** 2, axis=1)


def _fit(x: Floats, y: Floats) -> Floats:
    """Fit gains (k, 3) to inputs (b, n, k) and responses (b, n, 3), with a weight for each block."""
    size = x.shape[2]
    ridge = RIDGE * np.eye(size) + (TOGETHER / size if size > 3 else 0.0) * np.ones((size, size))
    squares, across = np.swapaxes(x, 1, 2) @ x, np.swapaxes(x, 1, 2) @ y
    gain = np.zeros((size, 3))
    for _ in range(ROUNDS):
        left = _left(x, y, gain)
        weight = 1.0 / np.maximum(left, np.median(left, axis=0) + 1e-12)
        for column in range(3):
            total = np.tensordot(weight[:, column], squares, 1)
            total += float(np.trace(total)) / size * ridge + 1e-12 * np.eye(size)
            gain[:, column] = np.linalg.solve(total, weight[:, column] @ across[:, :, column])
    return gain
