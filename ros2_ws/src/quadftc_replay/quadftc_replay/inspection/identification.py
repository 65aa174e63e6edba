"""A model of the vehicle from its own log: angular acceleration and specific force from the rotors.

    alpha = G u_T + d,    f_z = k u_T + c,    T u_T' = u - u_T

u is what drives: rotor speeds squared, rotor commands, or commanded torque; T is the rotors' lag, d and c are
slow. Least squares on what is between `BAND`, where slow disturbances and vibration are weak. Blocks of a
second with a large residual weigh less, so that the stretch after a fault hardly counts. T is searched for.
Gains that the log does not excite stay at their prior: as much lift as the weight, and no torque. Rotors
together have next to none whatever the log says: climbs and turns that go together would give them some.

All signals are means over the bins of one grid, behind the same low-pass; they need no equal sampling. Its
edge lies where the spectrum of the gyro is least, between motion and vibration. R² is what a fit to every
other block explains of the blocks between. Standard deviations are those of a jackknife over the blocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.whitening import Floats, Mask

FINE = 500.0  # Hz; of the bins, or the rate of the gyro if that is less
GRID = 125.0  # Hz; of what is left of them behind the low-pass
VALLEY = (18.0, 60.0)  # Hz; in which motion ends and vibration begins
BAND = (1.0, 15.0)  # Hz; no more than 40 % of half the rate of the bins; below, gusts drive the rotors
LAGS = np.array([0, 5, 10, 15, 20, 30, 40, 50, 60, 70, 85, 100, 120, 150]) * 1e-3  # s
BLOCK = 1.0  # s
ROUNDS = 4  # of the reweighted fit
RIDGE = 3e-3  # 1; of the mean power of the inputs: where a log excites them less, gains stay at the prior
TOGETHER = 30.0  # 1; as much again for all rotors together, which hardly turn a vehicle
USABLE = 0.3  # 1; R² of an axis from which it is used
AT_ALL, CLEAR = 0.05, 5.0  # 1; a lower one, if the gains are so many standard deviations
SLOWEST = 25.0  # Hz; of gyro and inputs
LEAST = 4  # blocks


class Grid(NamedTuple):
    """Means of all signals over the same bins."""

    time: Floats  # (n,) middle of the bin [s]
    dt: float  # s
    rate: Floats  # (n, 3) [rad/s]
    force: Floats | None  # (n,) specific force along z [m/s²]
    inputs: Floats  # (n, k)
    flying: Mask  # (n,) in flight, and every signal has samples

    def until(self, time: float) -> Grid:
        """Return the bins up to a time [s]."""
        rows = int(np.searchsorted(self.time, time))
        return self._replace(
            **{
                name: values[:rows]
                for name, values in self._asdict().items()
                if isinstance(values, np.ndarray)
            }
        )


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
        and bool(np.isfinite(sensor.value).all(axis=1).sum() > 20)
    )


def bin_means(edges: Floats, sensor: Signal, hold: bool) -> Floats:
    """Means over bins (n - 1, k); a signal is held from sample to sample, or goes straight between them."""
    whole = np.isfinite(sensor.value).all(axis=1)
    time, value = sensor.time[whole], sensor.value[whole]
    if len(time) < 2:
        return np.full((len(edges) - 1, sensor.value.shape[1]), np.nan)
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
    fine = min(FINE, gyro.rate)
    start = max(float(gyro.time[0]), float(drive.time[0]))
    end = min(float(gyro.time[-1]), float(drive.time[-1]))
    if end - start < LEAST * BLOCK:
        return None
    edges = np.arange(start, end, 1.0 / fine)
    time = 0.5 * (edges[1:] + edges[:-1])
    force_sensor = next(iter(flight.log.accelerometers.values()), None)
    flying = flight.in_flight(time) & ~flight.near_impact(time)
    flying &= _has_samples(edges, gyro, 3.0 / gyro.rate) & _has_samples(edges, drive, 3.0 / drive.rate)
    columns = [bin_means(edges, gyro, hold=False), bin_means(edges, drive, hold=True)]
    if force_sensor is not None and force_sensor.rate >= SLOWEST:
        columns.append(bin_means(edges, force_sensor, hold=False)[:, 2:])
        flying &= _has_samples(edges, force_sensor, 3.0 / force_sensor.rate)
    cutoff = choose_cutoff(columns[0][flying], fine)
    stride = max(1, round(fine / GRID))
    smooth = [_low_pass(np.nan_to_num(each), cutoff, fine)[::stride] for each in columns]
    force = smooth[2][:, 0] if len(smooth) > 2 else None
    return Grid(time[::stride], stride / fine, smooth[0], force, smooth[1], flying[::stride])


def choose_cutoff(rates: Floats, rate: float) -> float | None:
    """Return the frequency [Hz] between motion and vibration, where the spectrum is least; None: no such."""
    if len(rates) < 4 * round(rate):
        return None
    frequency, power = signal.welch(rates, fs=rate, nperseg=round(rate), axis=0)
    between = (frequency >= VALLEY[0]) & (frequency <= min(VALLEY[1], 0.4 * rate))
    if between.sum() < 5:
        return None
    level = ndimage.median_filter(np.log(power.sum(axis=1) + 1e-20), 5)
    return float(frequency[between][np.argmin(level[between])])


def _low_pass(values: Floats, cutoff: float | None, rate: float) -> Floats:
    """Take out what is faster than a frequency [Hz], without delay."""
    if cutoff is None or cutoff >= 0.45 * rate:
        return values
    return signal.sosfiltfilt(signal.butter(2, cutoff, fs=rate, output="sos"), values, axis=0)


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


class BlockSums(NamedTuple):
    """Sums over each block, all that a fit needs."""

    squares: Floats  # (b, k, k) of the inputs behind the lag
    across: Floats  # (b, k, c) of inputs and responses
    power: Floats  # (b, c) of the responses
    samples: Floats  # (b,)

    def part(self, blocks: Mask) -> BlockSums:
        """Return some blocks."""
        return BlockSums(*(values[blocks] for values in self))


class Blocks(NamedTuple):
    """A flight in blocks, for every lag."""

    sums: tuple[BlockSums, ...]  # one for each of `LAGS`
    end: Floats  # (b,) of each block [s]
    flown: Mask  # (b,) whether it is flown for three quarters


def in_blocks(grid: Grid) -> Blocks:
    """Sum up the blocks of a flight."""
    band = [BAND[0], min(BAND[1], 0.2 / grid.dt)]
    bands = signal.butter(2, band, "bandpass", fs=1.0 / grid.dt, output="sos")
    measured = signal.sosfiltfilt(bands, np.nan_to_num(responses(grid)), axis=0)
    driven = signal.sosfiltfilt(bands, smooth_like_gradient(np.nan_to_num(grid.inputs)), axis=0)
    length = round(BLOCK / grid.dt)
    starts = np.arange(0, len(grid.time), length)
    flown = np.add.reduceat(grid.flying.astype(float), starts)
    sums = tuple(_sum_up(lagged(driven, float(lag), grid.dt), measured, starts) for lag in LAGS)
    ends = grid.time[np.minimum(starts + length, len(grid.time)) - 1]
    return Blocks(sums, ends, flown > 0.75 * length)


def _sum_up(driven: Floats, measured: Floats, starts: NDArray[np.int_]) -> BlockSums:
    return BlockSums(
        squares=np.add.reduceat(driven[:, :, None] * driven[:, None, :], starts, axis=0),
        across=np.add.reduceat(driven[:, :, None] * measured[:, None, :], starts, axis=0),
        power=np.add.reduceat(measured**2, starts, axis=0),
        samples=np.diff(np.append(starts, len(driven))).astype(float),
    )


def identify(
    source: str, grid: Grid, blocks: Blocks, until: float = np.inf, since: float = -np.inf
) -> Identified | None:
    """Fit the model to the flight between two times [s]; None if that is too little."""
    rows = blocks.flown & (blocks.end < until) & (blocks.end > since + BLOCK)
    if rows.sum() < LEAST:
        return None
    prior = _prior(grid)
    best: tuple[float, float, Floats, BlockSums] | None = None
    for lag, sums in zip(LAGS.tolist(), blocks.sums, strict=True):
        part = sums.part(rows)
        r2 = _held_out(part, prior)
        score = float(np.sum(np.clip(r2[:2], -1.0, 1.0)))
        if best is None or score > best[0]:
            best = score, lag, r2, part
    assert best is not None
    _, lag, r2, part = best
    gain, spread = _fit_all(part, prior)
    clear = np.linalg.norm(gain, axis=0) > CLEAR * np.linalg.norm(spread, axis=0)
    return Identified(source, lag, gain, spread, r2, (r2 > USABLE) | ((r2 > AT_ALL) & clear))


def _prior(grid: Grid) -> Floats:
    """Gains before anything is fitted (k, c): no torque, and together the weight."""
    lift = np.nansum(grid.inputs[grid.flying].mean(axis=0))
    columns = 3 if grid.force is None else 4
    prior = np.zeros((grid.inputs.shape[1], columns))
    if grid.force is not None and lift > 0.0:
        prior[:, 3] = STANDARD_GRAVITY / lift
    return prior


def _held_out(sums: BlockSums, prior: Floats) -> Floats:
    """R² of each column, on blocks that were not fitted: of all, or of the usual one if that is more."""
    parity = np.arange(len(sums.samples)) % 2 == 0
    rest: list[Floats] = []
    for fit in (parity, ~parity):
        gain, _ = _fit_all(sums.part(fit), prior, with_spread=False)
        rest.append(_residuals(sums.part(~fit), gain))
    left = np.concatenate(rest)
    power = np.concatenate([sums.power[~parity], sums.power[parity]])
    pooled = 1.0 - left.sum(axis=0) / np.maximum(power.sum(axis=0), 1e-12)
    usual = 1.0 - np.median(left / np.maximum(power, 1e-12), axis=0)
    return np.maximum(pooled, usual)


def _residuals(sums: BlockSums, gain: Floats) -> Floats:
    """Sum of squares that gains (k, c) leave in each block (b, c)."""
    cross = np.einsum("bkc,kc->bc", sums.across, gain)
    own = np.einsum("kc,bkl,lc->bc", gain, sums.squares, gain)
    return np.maximum(sums.power - 2.0 * cross + own, 0.0)


def _fit_all(sums: BlockSums, prior: Floats, with_spread: bool = True) -> tuple[Floats, Floats]:
    """Fit all columns; all rotors lift alike, so that the force has one gain."""
    turning = sums._replace(across=sums.across[..., :3], power=sums.power[:, :3])
    gain, spread = _fit(turning, with_spread)
    if prior.shape[1] == 3:
        return gain, spread
    lift = prior[:, 3:]
    together = BlockSums(
        squares=sums.squares.sum(axis=(1, 2))[:, None, None],
        across=(sums.across[..., 3:] - sums.squares @ lift).sum(axis=1, keepdims=True),
        power=_residuals(sums._replace(across=sums.across[..., 3:], power=sums.power[:, 3:]), lift),
        samples=sums.samples,
    )
    more, more_std = _fit(together, with_spread)
    ones = np.ones_like(lift)
    return np.hstack([gain, lift + more * ones]), np.hstack([spread, more_std * ones])


def _fit(sums: BlockSums, with_spread: bool) -> tuple[Floats, Floats]:
    """Fit gains (k, c) with block weights; return them and their standard deviations."""
    count, size, columns = sums.across.shape
    ridge = RIDGE * np.eye(size) + (TOGETHER / size if size > 3 else 0.0) * np.ones((size, size))
    gain, spread = np.zeros((size, columns)), np.full((size, columns), np.inf)
    for column in range(columns):
        each = sums.across[:, :, column]
        one = BlockSums(sums.squares, sums.across[:, :, [column]], sums.power[:, [column]], sums.samples)
        left = sums.power[:, column] / sums.samples
        weight, total = np.ones(count), sums.squares.sum(axis=0)
        for _ in range(ROUNDS):
            weight = 1.0 / np.maximum(left, float(np.median(left)) + 1e-12)
            total = np.einsum("b,bij->ij", weight, sums.squares)
            total += float(np.trace(total)) / size * ridge + 1e-12 * np.eye(size)
            gain[:, column] = np.linalg.solve(total, weight @ each)
            left = _residuals(one, gain[:, [column]])[:, 0] / sums.samples
        if with_spread and count > 2:
            without = total[None] - weight[:, None, None] * sums.squares
            sides = weight @ each - weight[:, None] * each
            others: list[Floats] = [
                np.linalg.solve(part, side) for part, side in zip(without, sides, strict=True)
            ]
            spread[:, column] = np.sqrt((count - 1) * np.var(np.array(others), axis=0))
    return gain, spread
