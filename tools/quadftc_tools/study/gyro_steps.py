"""Steps overlaid on recorded gyros, what a test of the gyro says of them, and how good that is.

A test is anything with ``start`` and ``step`` on a sample; its state is a tree of arrays with any leading
axes. It runs along the recording once, as it is. At each onset its state is copied for all steps (every axis,
size and sign), which then go on together for as long as they are judged.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.fault_observer import FaultObserver
from quadftc_model.samples import ALARMS, FaultObserverInputs, ImuSample

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIZES = (0.2, 0.4)  # rad/s
DEADLINES = (0.012, 0.1)  # s; within which a step shall be found
EVERY = 0.2  # s; between two onsets
SETTLE = 1.0  # s; from the first row to the first onset
CASES = tuple(itertools.product(range(3), SIZES, (1.0, -1.0)))  # axis, size, sign
STEPS = np.array([[sign * size * (k == axis) for k in range(3)] for axis, size, sign in CASES])


class Sample(NamedTuple):
    """What a test sees."""

    gyro: Floats  # (..., 3) [rad/s]
    q_xyzw: Floats | None  # (..., 4); None: not recorded
    drive: Floats  # (..., 3) mean acceleration by the torque since the sample before [rad/s²]


class Named(NamedTuple):
    """What a test says at a sample."""

    gyro: Mask  # (..., 3) this axis of the gyro is faulty
    other: Mask  # (..., 3) something else of this axis is, or may as well be


class GyroTest(Protocol):
    """A test of the gyro."""

    def start(self, sample: Sample) -> Any:
        """Return the state at the first sample."""
        ...

    def step(self, state: Any, sample: Sample, dt: float) -> tuple[Any, Named]:
        """Advance by ``dt`` [s] to a sample."""
        ...


@dataclasses.dataclass(frozen=True, kw_only=True)
class JumpTest:
    """The crudest test that works: a jump of the gyro against torque and a short trend.

    The innovation is the change of the rate less what torque and trend predict. The trend is the mean of what
    they missed lately; the level is a multiple of the learned noise. An axis stays named for some time.
    """

    level: float = 8.0  # 1; standard deviations
    trend: float = 0.02  # s
    memory: float = 1.0  # s; of the noise
    floor: float = 0.01  # rad/s; of the noise in flight: more than at rest
    hold: float = 0.5  # s

    class State(NamedTuple):
        """Last reading, trend, noise, and for how long an axis is named still."""

        gyro: Floats
        trend: Floats  # rad/s²
        variance: Floats  # rad²/s²
        left: Floats  # s

    def start(self, sample: Sample) -> State:
        """Return the state at the first sample."""
        zeros = np.zeros_like(sample.gyro)
        return self.State(sample.gyro, zeros, zeros + (2.0 * self.floor) ** 2, zeros)

    def step(self, state: State, sample: Sample, dt: float) -> tuple[State, Named]:
        """Advance by ``dt`` [s] to a sample."""
        innovation = sample.gyro - state.gyro - (sample.drive + state.trend) * dt
        square = innovation * innovation
        jump = square > self.level**2 * np.maximum(state.variance, self.floor**2)
        follow, learn = (~jump * -np.expm1(-dt / time) for time in (self.trend, self.memory))
        left = np.where(jump, self.hold, np.maximum(state.left - dt, 0.0))
        after = self.State(
            sample.gyro,
            state.trend + follow * innovation / dt,
            state.variance + learn * (square - state.variance),
            left,
        )
        return after, Named(left > 0.0, np.zeros_like(jump))


@dataclasses.dataclass(frozen=True)
class ObserverTest:
    """What a fault observer says of the gyro. Without an attitude, it is told that there is none."""

    law: FaultObserver

    def start(self, sample: Sample) -> Any:
        """Return the state at the first sample."""
        return self.law.init(self._inputs(sample))

    def step(self, state: Any, sample: Sample, dt: float) -> tuple[Any, Named]:
        """Advance by ``dt`` [s] to a sample."""
        state, estimate = self.law.step(state, self._inputs(sample), dt)
        if estimate.sensors is None:
            raise ValueError(f"{type(self.law).__name__} says nothing of the gyro")
        gyro, attitude = estimate.sensors.gyro, estimate.sensors.attitude
        alarm = [np.isin(each.state, ALARMS) for each in (gyro, attitude)]
        sure = alarm[0] & ~gyro.ambiguous
        return state, Named(sure, alarm[1] | (alarm[0] & ~sure))

    def _inputs(self, sample: Sample) -> FaultObserverInputs:
        shape = sample.gyro.shape[:-1]
        there = np.ones(shape, np.bool_)
        level = np.broadcast_to(np.array([0.0, 0.0, 0.0, 1.0]), (*shape, 4))
        has_attitude = sample.q_xyzw is not None
        q_xyzw = level if sample.q_xyzw is None else sample.q_xyzw
        force = np.zeros_like(sample.gyro)
        imu = ImuSample(q_xyzw, sample.gyro, force, there & has_attitude, there, ~there)
        return FaultObserverInputs(imu, sample.drive * self.law.vehicle.inertia)


class Recorded(NamedTuple):
    """A recorded flight as samples."""

    time: Floats  # (n,) [s]
    gyro: Floats  # (n, 3) [rad/s]
    q_xyzw: Floats | None  # (n, 4)
    drive: Floats  # (n, 3) mean since the row before [rad/s²]
    flying: Mask  # (n,)

    def part(self, rows: slice) -> Recorded:
        """Return some rows."""
        q_xyzw = None if self.q_xyzw is None else self.q_xyzw[rows]
        return Recorded(self.time[rows], self.gyro[rows], q_xyzw, self.drive[rows], self.flying[rows])

    def sample(self, row: int, added: Floats | float = 0.0) -> Sample:
        """Return a sample, with something added to the gyro [rad/s] (..., 3)."""
        gyro = self.gyro[row] + added
        shape = gyro.shape[:-1]
        q_xyzw = None if self.q_xyzw is None else np.broadcast_to(self.q_xyzw[row], (*shape, 4))
        return Sample(gyro, q_xyzw, np.broadcast_to(self.drive[row], (*shape, 3)))


class Verdicts(NamedTuple):
    """What became of the steps at one onset; leading axis: `CASES`."""

    before: Mask  # (c,) something was named when the step came
    delay: Floats  # (c,) from the first faulty sample until its axis of the gyro was named [s]; inf: never
    alone: Mask  # (c,) nothing else was named up to the last deadline


class Result(NamedTuple):
    """What a test did on a recording."""

    verdicts: Verdicts  # leading axes: onsets, cases
    alarms: NDArray[np.int64]  # (3,) how often an axis was named in flight, as recorded
    alarms_elsewhere: NDArray[np.int64]  # (3,) the same on the ground and in crashes
    hours: float  # in flight


def judge(test: GyroTest, recorded: Recorded) -> Result:
    """Run a test along a recording, and on steps at many onsets."""
    onsets = set(onset_rows(recorded))
    verdicts: list[Verdicts] = []
    state, named = test.start(recorded.sample(0)), Named(np.zeros(3, np.bool_), np.zeros(3, np.bool_))
    said = [named]
    steps = np.diff(recorded.time).tolist()
    for row, dt in enumerate(steps, 1):
        if row in onsets:
            verdicts.append(_judge_steps(test, recorded, row, state, named))
        state, named = test.step(state, recorded.sample(row), dt)
        said.append(named)
    on = np.array([each.gyro | each.other for each in said])
    raised = np.diff(on.astype(np.int8), axis=0, prepend=0) > 0
    flying = recorded.flying
    duration = float(np.sum(np.diff(recorded.time)[flying[1:]]))
    return Result(
        Verdicts(*map(np.stack, zip(*verdicts, strict=True))),
        raised[flying].sum(axis=0),
        raised[~flying].sum(axis=0),
        duration / 3600.0,
    )


def onset_rows(recorded: Recorded) -> list[int]:
    """Rows at which steps begin: every `EVERY` in flight, with time to be found."""
    time = recorded.time
    inside = time[recorded.flying]
    first = max(float(inside[0]), float(time[0]) + SETTLE)
    rows = np.searchsorted(time, np.arange(first, float(inside[-1]) - DEADLINES[-1], EVERY))
    return [int(row) for row in rows if recorded.flying[row]]


def _repeat(leaf: Any) -> NDArray[Any]:
    """Copy an array for every case."""
    return np.repeat(np.asarray(leaf)[None], len(CASES), axis=0)


def _judge_steps(test: GyroTest, recorded: Recorded, onset: int, state: Any, named: Named) -> Verdicts:
    """Run all steps from one onset on, from the state and the word of the sample before."""
    count, axes = len(CASES), np.array([axis for axis, _, _ in CASES])
    state = jax.tree_util.tree_map(_repeat, state)
    begin = float(recorded.time[onset])
    delay, alone = np.full(count, np.inf), np.ones(count, np.bool_)
    end = int(np.searchsorted(recorded.time, begin + DEADLINES[-1], side="right"))
    own = np.arange(3) == axes[:, None]
    for row in range(onset, end):
        dt = float(recorded.time[row] - recorded.time[row - 1])
        state, said = test.step(state, recorded.sample(row, STEPS), dt)
        found = np.any(said.gyro & own, axis=1) & ~np.isfinite(delay)
        delay[found] = float(recorded.time[row]) - begin
        alone &= ~np.any((said.gyro & ~own) | said.other, axis=1)
    before = bool(np.any(named.gyro | named.other))
    return Verdicts(np.full(count, before), delay, alone)


class Rates(NamedTuple):
    """How good a test is with steps of one size that came while nothing was named; 0 if there are none."""

    steps: int
    found: tuple[float, ...]  # within each deadline
    isolated: float  # the right axis of the gyro was named within the last deadline, and nothing else


def rates(results: Sequence[Result], size: float) -> Rates:
    """Sum up the steps of one size."""
    rows = [k for k, case in enumerate(CASES) if case[1] == size]
    healthy = ~np.concatenate([result.verdicts.before[:, rows] for result in results])
    delay: Floats = np.concatenate([result.verdicts.delay[:, rows] for result in results])[healthy]
    alone: Mask = np.concatenate([result.verdicts.alone[:, rows] for result in results])[healthy]
    late: list[float] = np.nextafter(np.array(DEADLINES), 1.0).tolist()
    found = [delay <= deadline for deadline in late]
    count = max(len(delay), 1)
    shares = [float(each.sum()) / count for each in (*found, found[-1] & alone)]
    return Rates(len(delay), tuple(shares[:-1]), shares[-1])


def delays(results: Sequence[Result]) -> Floats:
    """Delays of all steps that were found [s]; one that is infinite if none was."""
    delay = np.concatenate([result.verdicts.delay[~result.verdicts.before] for result in results])
    known = delay[np.isfinite(delay)]
    return known if len(known) else np.array([np.inf])
