"""A model of the vehicle from its own log: angular acceleration and specific force from the rotors.

    alpha = G u_T + d,    f_z = k u_T + c,    T u_T' = u - u_T

u is what drives: rotor speeds squared, rotor commands, or commanded torque; T is the rotors' lag, d and c are
slow. Least squares on what is between `BAND`, where slow disturbances and vibration are weak. Blocks of a
second with a large residual weigh less, so that the stretch after a fault hardly counts. T is searched for.
Gains that the log does not excite stay at their prior: no torque by all rotors together, and as much lift as
the weight.

All signals are means over the bins of one grid, which needs no equal sampling. R² is what a fit to every
other block explains of the blocks between. Standard deviations are those of a jackknife over the blocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.whitening import Floats, Mask

GRID = 125.0  # Hz; of the bins, or the rate of the gyro if that is less
BAND = (1.0, 15.0)  # Hz; no more than 40 % of half the rate of the bins; below, gusts drive the rotors
LAGS = np.array([0, 5, 10, 15, 20, 30, 40, 50, 60, 70, 85, 100, 120, 150]) * 1e-3  # s
BLOCK = 1.0  # s
ROUNDS = 4  # of the reweighted fit
RIDGE = 3e-3  # 1; of the mean power of the inputs: where a log excites them less, gains stay at the prior
USABLE = 0.3  # 1; R² of an axis from which it is used
SLOWEST = 25.0  # Hz; of gyro and inputs
LEAST = 5  # blocks


class Grid(NamedTuple):
    """Means of all signals over the same bins."""

    time: Floats  # (n,) middle of the bin [s]
    dt: float  # s
    rate: Floats  # (n, 3) [rad/s]
    force: Floats | None  # (n,) specific force along z [m/s²]
    inputs: Floats  # (n, k)
    flying: Mask  # (n,) in flight, and every signal has samples


class Identified(NamedTuple):
    """The model; columns are roll, pitch, yaw and, with an accelerometer, the force along z."""

    source: str  # rotor_speeds, rotor_commands or torque_command
    lag: float  # s
    gain: Floats  # (k, 3 or 4) per unit of input
    gain_std: Floats  # (k, 3 or 4)
    r2: Floats  # (3 or 4,) of the blocks that were not fitted
    usable: Mask  # (3 or 4,)


def drive_of(log: FlightLog) -> tuple[str, Signal] | None:
    """Return what drives the vehicle (n, k) and what it is called; None: not logged, or too slow."""
    if _is_there(log.rotor_speeds):
        assert log.rotor_speeds is not None
        squares = log.rotor_speeds.value**2
        usual = float(np.nanmedian(squares[squares > 0.0])) if np.any(squares > 0.0) else 1.0
        return "rotor_speeds", Signal(log.rotor_speeds.time, squares / usual)
    for name in ("rotor_commands", "torque_command"):
        found: Signal | None = getattr(log, name)
        if _is_there(found):
            assert found is not None
            return name, found
    return None


def _is_there(sensor: Signal | None) -> bool:
    return (
        sensor is not None
        and len(sensor) > 20
        and sensor.rate >= SLOWEST
        and bool(np.isfinite(sensor.value).any(axis=0).all())
    )


def bin_means(edges: Floats, sensor: Signal, hold: bool) -> Floats:
    """Means over bins (n - 1, k); a signal is held from sample to sample, or goes straight between them."""
    whole = np.isfinite(sensor.value).all(axis=1)
    time, value = sensor.time[whole], sensor.value[whole]
    steps = np.diff(time)[:, None]
    between = value[:-1] if hold else 0.5 * (value[:-1] + value[1:])
    total = np.concatenate([np.zeros((1, value.shape[1])), np.cumsum(between * steps, axis=0)])
    at = np.stack([np.interp(edges, time, total[:, k]) for k in range(value.shape[1])], axis=-1)
    return np.diff(at, axis=0) / np.diff(edges)[:, None]


def _has_samples(edges: Floats, sensor: Signal, slack: float) -> Mask:
    """Whether each bin is within reach of a sample on both sides (n - 1,)."""
    time = sensor.time[np.isfinite(sensor.value).all(axis=1)]
    if len(time) < 2:
        return np.zeros(len(edges) - 1, np.bool_)
    after = time[np.clip(np.searchsorted(time, edges[1:]), 0, len(time) - 1)]
    before = time[np.clip(np.searchsorted(time, edges[:-1], side="right") - 1, 0, len(time) - 1)]
    return (after - before < slack + (edges[1] - edges[0])) & (before <= edges[:-1]) & (after >= edges[1:])


def make_grid(flight: Flight, drive: Signal) -> Grid | None:
    """Put gyro, accelerometer and drive on one grid; None if they are too slow or hardly overlap."""
    gyro = flight.gyro[1] if flight.gyro is not None else None
    if gyro is None or min(gyro.rate, drive.rate) < SLOWEST:
        return None
    rate = min(GRID, gyro.rate)
    start = max(float(gyro.time[0]), float(drive.time[0]))
    end = min(float(gyro.time[-1]), float(drive.time[-1]))
    if end - start < LEAST * BLOCK:
        return None
    edges = np.arange(start, end, 1.0 / rate)
    time = 0.5 * (edges[1:] + edges[:-1])
    force_sensor = next(iter(flight.log.accelerometers.values()), None)
    flying = flight.in_flight(time) & ~flight.near_impact(time)
    flying &= _has_samples(edges, gyro, 3.0 / gyro.rate) & _has_samples(edges, drive, 3.0 / drive.rate)
    force = None
    if force_sensor is not None and force_sensor.rate >= SLOWEST:
        force = bin_means(edges, force_sensor, hold=False)[:, 2]
        flying &= _has_samples(edges, force_sensor, 3.0 / force_sensor.rate)
    rates = bin_means(edges, gyro, hold=False)
    return Grid(time, 1.0 / rate, rates, force, bin_means(edges, drive, hold=True), flying)


def lagged(inputs: Floats, lag: float, dt: float) -> Floats:
    """Put the rotors' lag on inputs (n, k), settled at the first."""
    if lag <= 0.0:
        return inputs
    share = float(np.exp(-dt / lag))
    return signal.lfilter([1.0 - share], [1.0, -share], inputs, axis=0, zi=share * inputs[:1])[0]


def responses(grid: Grid) -> Floats:
    """Angular acceleration [rad/s²] and, where there is one, force along z [m/s²] (n, 3 or 4)."""
    alpha = np.gradient(grid.rate, grid.dt, axis=0)
    return alpha if grid.force is None else np.column_stack([alpha, grid.force])


def smooth_like_gradient(values: Floats) -> Floats:
    """Means over the two bins that a central difference spans (n, k)."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    return 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]


def identify(source: str, grid: Grid) -> Identified | None:
    """Fit the model to a grid; None if there is too little flight."""
    half = 0.5 / grid.dt
    band = [BAND[0], min(BAND[1], 0.4 * half)]
    bands = signal.butter(2, band, "bandpass", fs=1.0 / grid.dt, output="sos")
    blocks = np.floor((grid.time - grid.time[0]) / BLOCK).astype(int)
    rows = grid.flying & _whole_blocks(blocks, grid.flying)
    if len(np.unique(blocks[rows])) < LEAST:
        return None
    measured = signal.sosfiltfilt(bands, np.nan_to_num(responses(grid)), axis=0)
    best: tuple[float, float, Floats, Floats] | None = None
    prior = _prior(grid)
    for lag in LAGS:
        driven = smooth_like_gradient(lagged(np.nan_to_num(grid.inputs), float(lag), grid.dt))
        driven = signal.sosfiltfilt(bands, driven, axis=0)
        r2 = _held_out(driven[rows], measured[rows], prior, blocks[rows])
        score = float(np.sum(np.clip(r2[:2], -1.0, 1.0)))
        if best is None or score > best[0]:
            best = score, float(lag), r2, driven
    assert best is not None
    _, lag, r2, driven = best
    gain, spread = _fit_all(driven[rows], measured[rows], prior, blocks[rows])
    return Identified(source, lag, gain, spread, r2, r2 > USABLE)


def _whole_blocks(blocks: NDArray[np.int_], flying: Mask) -> Mask:
    """Whether each bin is in a block that is flown for 90 % (n,)."""
    counts = np.bincount(blocks)
    flown = np.bincount(blocks, weights=flying)
    return (flown > 0.9 * counts)[blocks]


def _prior(grid: Grid) -> Floats:
    """Gains before anything is fitted (k, c): no torque, and together the weight."""
    lift = np.nansum(grid.inputs[grid.flying].mean(axis=0))
    columns = 3 if grid.force is None else 4
    prior = np.zeros((grid.inputs.shape[1], columns))
    if grid.force is not None and lift > 0.0:
        prior[:, 3] = STANDARD_GRAVITY / lift
    return prior


def _held_out(driven: Floats, measured: Floats, prior: Floats, blocks: NDArray[np.int_]) -> Floats:
    """R² of each column, on blocks that were not fitted: of all, or of the usual one if that is more."""
    parity = blocks % 2
    total, rest = np.zeros((0, measured.shape[1])), np.zeros((0, measured.shape[1]))
    for fold in (0, 1):
        fit, held = parity == fold, parity != fold
        gain, _ = _fit_all(driven[fit], measured[fit], prior, blocks[fit], with_spread=False)
        error = measured[held] - driven[held] @ gain
        numbers = np.unique(blocks[held], return_inverse=True)[1]
        rest = np.concatenate([rest, _sums(error**2, numbers)])
        total = np.concatenate([total, _sums(measured[held] ** 2, numbers)])
    pooled = 1.0 - rest.sum(axis=0) / np.maximum(total.sum(axis=0), 1e-12)
    usual = 1.0 - np.median(rest / np.maximum(total, 1e-12), axis=0)
    return np.maximum(pooled, usual)


def _fit_all(
    driven: Floats, measured: Floats, prior: Floats, blocks: NDArray[np.int_], with_spread: bool = True
) -> tuple[Floats, Floats]:
    """Fit all columns; all rotors lift alike, so that the force has one gain."""
    gain, spread = _fit(driven, measured[:, :3], blocks, with_spread)
    if measured.shape[1] == 3:
        return gain, spread
    together = driven.sum(axis=1, keepdims=True)
    lift, lift_std = _fit(together, measured[:, 3:] - driven @ prior[:, 3:], blocks, with_spread)
    ones = np.ones((driven.shape[1], 1))
    return np.hstack([gain, prior[:, 3:] + lift * ones]), np.hstack([spread, lift_std * ones])


def _sums(values: Floats, numbers: NDArray[np.int_]) -> Floats:
    found = np.zeros((int(numbers.max()) + 1, values.shape[1]))
    np.add.at(found, numbers, values)
    return found


def _fit(
    driven: Floats, measured: Floats, blocks: NDArray[np.int_], with_spread: bool = True
) -> tuple[Floats, Floats]:
    """Fit gains (k, c) with block weights; return them and their standard deviations."""
    numbers = np.unique(blocks, return_inverse=True)[1]
    count, size = int(numbers.max()) + 1, driven.shape[1]
    parts = [numbers == b for b in range(count)]
    squares: Floats = np.stack([driven[part].T @ driven[part] for part in parts])
    across: Floats = np.stack([driven[part].T @ measured[part] for part in parts])
    power = _sums(measured**2, numbers)
    samples = np.bincount(numbers)[:, None]
    rest = power / samples
    gain = np.zeros((size, measured.shape[1]))
    spread = np.full_like(gain, np.inf)
    for column in range(measured.shape[1]):
        each = across[:, :, column]
        left, weight, total = rest[:, column], np.ones(count), squares.sum(axis=0)
        for _ in range(ROUNDS):
            weight = 1.0 / np.maximum(left, float(np.median(left)) + 1e-12)
            total = np.einsum("b,bij->ij", weight, squares)
            total += (RIDGE * float(np.trace(total)) / size + 1e-12) * np.eye(size)
            gain[:, column] = np.linalg.solve(total, weight @ each)
            now = gain[:, column]
            left = power[:, column] - 2.0 * each @ now + np.einsum("i,bij,j->b", now, squares, now)
            left = np.maximum(left, 0.0) / samples[:, 0]
        if with_spread and count > 2:
            without = total[None] - weight[:, None, None] * squares
            sides = weight @ each - weight[:, None] * each
            others: list[Floats] = [
                np.linalg.solve(part, side) for part, side in zip(without, sides, strict=True)
            ]
            spread[:, column] = np.sqrt((count - 1) * np.var(np.array(others), axis=0))
    return gain, spread
