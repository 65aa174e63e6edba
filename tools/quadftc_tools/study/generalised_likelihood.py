# pyright: basic
r"""Generalised likelihood ratios (Willsky and Jones 1976) beside `isolating`, on the same samples.

python3 -m quadftc_tools.study.generalised_likelihood --flights 50 --docs docs

Each axis has two Kalman filters that take everything for healthy: angle and gyro bias by attitude and gyro;
rate and unknown acceleration by gyro and torque. What a fault of size f with an onset at row k does to their
innovations is known: f s(i) at row k + i. With innovations v of variance V,

    l(k) = (sum_i s v / V)² / sum_i s² / V

is twice the log-likelihood ratio of the best f. The largest over all onsets of the last `WINDOW`, and over
all hypotheses, decides. Attitude or gyro is named where it leads by `MARGIN`, and stays so.

The samples are those of healthy flights in gusts, without diagnosis, and faults are added to them: what is
said of them has no effect on the flight, so both judge the same.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.fault_observer import fault_observer_from
from quadftc_fdi.isolation.rate_filter import rotation_to
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import load_scenario, with_duration, with_seed
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import ALARMS, FaultObserverInputs, ImuSample
from quadftc_sim.sensors import ImuSensor
from quadftc_tools.study.numbers import write_per_cent, write_times
from quadftc_tools.study.page import markdown, publish

Floats = NDArray[np.float64]
Words = NDArray[np.int8]  # (rows, flights, axes)

SCENARIO = Path(__file__).resolve().parents[3] / "campaigns" / "scenarios" / "which_sensor.yaml"
DEG = math.pi / 180.0
DURATION, ONSET, SETTLED = 12.0, 8.0, 5.0  # s; from the last on, alarms count
WINDOW = 0.5  # s; of onsets
LEVEL = 36.0  # 1; of l, as an outlier of `isolating`: six standard deviations
MARGIN = 2.0 * math.log(19.0)  # 1; of l, as `isolating` names a gyro: 95 %
NOTHING, ATTITUDE, GYRO, AMBIGUOUS = range(4)
# kind of fault -> sensor, smallest and largest size [SI], power of time with which it grows
FAULTS = {
    "gyro: step of 0.15 to 0.5 rad/s": (GYRO, 0.15, 0.5, 0),
    "gyro: ramp of 0.05 to 0.5 rad/s²": (GYRO, 0.05, 0.5, 1),
    "attitude: step of 0.5 to 10 deg": (ATTITUDE, 0.5 * DEG, 10.0 * DEG, 0),
    "attitude: ramp of 0.3 to 3 deg/s": (ATTITUDE, 0.3 * DEG, 3.0 * DEG, 1),
    "none": (NOTHING, 0.0, 0.0, 0),
}
HEAD = (
    "fault",
    "by",
    "named",
    "misnamed at some time",
    "ambiguous to the end",
    "named after, median / largest",
)


class Recorded(NamedTuple):
    """Samples of flights of one rate."""

    imu: ImuSample  # (rows, flights, ...)
    torque: Floats  # (rows, flights, 3) since the row before [N m]
    dt: float


@dataclasses.dataclass(frozen=True, eq=False)
class Listener:
    """The observer of a flight, which keeps what it is told."""

    has_detector: ClassVar[bool] = False

    law: Any
    heard: list[FaultObserverInputs]

    def init(self, inputs: FaultObserverInputs) -> Any:
        """Start at the first sample."""
        return self.law.init(inputs)

    def step(self, state: Any, inputs: FaultObserverInputs, dt: float) -> Any:
        """Advance by ``dt`` [s] to a sample."""
        self.heard.append(inputs)
        return self.law.step(state, inputs, dt)


def record(flights: int) -> Recorded:
    """Fly healthy vehicles with seeds and gusts of their own."""
    heard: list[list[FaultObserverInputs]] = []
    for seed in range(flights):
        changes = ["faults=[]", f"disturbances.0.history={seed}"]
        scenario = with_seed(with_duration(load_scenario(SCENARIO, changes), DURATION), seed)
        scheme, samples = scenario.scheme("without_diagnosis"), list[FaultObserverInputs]()
        listener = dataclasses.replace(scheme.observer, law=Listener(scheme.observer.law, samples))
        fly(scenario, scheme.model_copy(update={"observer": listener}))
        heard.append(samples)
    each = [[(*row.imu, row.torque) for row in samples] for samples in heard]
    *imu, torque = [np.stack([[row[k] for row in rows] for rows in each], axis=1) for k in range(7)]
    return Recorded(ImuSample(*imu), torque, 1.0 / scenario.rate)


def with_faults(recorded: Recorded, sensor: int, sizes: Floats, power: int) -> Recorded:
    """Add a fault of each flight (flights, 3), a step or a ramp."""
    elapsed = np.arange(len(recorded.torque)) * recorded.dt - ONSET
    fault = np.where(elapsed >= 0.0, elapsed**power, 0.0)[:, None, None] * sizes
    imu = recorded.imu
    if sensor == GYRO:
        imu = imu._replace(body_rate=imu.body_rate + fault)
    elif sensor == ATTITUDE:
        imu = imu._replace(q_xyzw=quaternion_from_euler(euler_from_quaternion(imu.q_xyzw) + fault))
    return recorded._replace(imu=imu)


class Filter(NamedTuple):
    """Kalman filter of x' = input + z, z a random walk, by x: its gains and variances, row by row."""

    gains: Floats  # (rows, 2)
    variance: Floats  # (rows,) of the innovation


def design(rows: int, dt: float, noises: tuple[float, float, float], start: tuple[float, float]) -> Filter:
    """Gains for variances of x and z in a step and of a measurement, from standard deviations of x and z."""
    F, Q, R = np.array([[1.0, dt], [0.0, 1.0]]), np.diag(noises[:2]), noises[2]
    P, gains, variance = np.diag(np.square(start)), np.empty((rows, 2)), np.empty(rows)
    for row in range(rows):
        P = F @ P @ F.T + Q
        variance[row] = P[0, 0] + R
        gains[row] = P[:, 0] / variance[row]
        P = P - variance[row] * np.outer(gains[row], gains[row])
    return Filter(gains, variance)


def innovations(gains: Floats, moved: Floats, driven: Floats, dt: float) -> Floats:
    """Innovations (rows, ...) of a filter that starts at x = 0.

    ``moved`` is by how much the measured x changes from row to row, ``driven`` the input since the last row.
    """
    x, z, out = np.zeros_like(moved[0]), np.zeros_like(moved[0]), np.empty_like(moved)
    for row, (a, b) in enumerate(gains.tolist()):
        x = x + dt * (driven[row] + z) - moved[row]  # from here on, x is relative to the measurement
        out[row] = -x
        x, z = x + a * out[row], z + b * out[row]
    return out


@dataclasses.dataclass(frozen=True)
class Bank:
    """Two filters of each axis, and what the faults do to their innovations."""

    filters: tuple[Filter, Filter]
    dt: float

    @classmethod
    def of(cls, sensor: ImuSensor, rows: int, dt: float) -> Bank:
        """Design it for an IMU whose noise is known."""
        gyro, attitude = sensor.gyro_noise**2, sensor.attitude_noise**2
        angle = design(rows, dt, (gyro * dt, (0.02 * DEG) ** 2 * dt, attitude), (0.1 * DEG, 1.0 * DEG))
        return cls((angle, design(rows, dt, (0.0, dt, gyro / dt), (0.1, 1.0))), dt)

    def signatures(self) -> Iterator[tuple[int, Floats]]:
        """Return sensor and innovations (2, rows) of each hypothesis; a disturbance is neither's."""
        rows, dt = round(WINDOW / self.dt), self.dt
        gains = [np.repeat(each.gains[-1:], rows, axis=0) for each in self.filters]
        none = np.zeros(rows)
        shapes: Any = np.ones(rows), (np.arange(rows) + 1.0) * dt  # a step, a ramp
        for fault in shapes:
            before: Any = np.concatenate([[0.0], fault[:-1]])
            moved, mean = fault - before, 0.5 * (fault + before)
            yield ATTITUDE, np.stack([innovations(gains[0], moved, none, dt), none])
            by_gyro = innovations(gains[0], none, mean, dt), innovations(gains[1], moved, none, dt)
            yield GYRO, np.stack(by_gyro)
        ramp = np.full(rows, dt)
        yield NOTHING, np.stack([none, innovations(gains[1], ramp, none, dt)])

    def judge(self, recorded: Recorded, inertia: Floats) -> Words:
        """Say of each row, flight and axis what is named."""
        imu, dt = recorded.imu, self.dt
        turned = rotation_to(imu.q_xyzw[:-1], imu.q_xyzw[1:])
        rate = imu.body_rate
        found = [
            innovations(self.filters[0].gains, _padded(turned), _padded(0.5 * (rate[1:] + rate[:-1])), dt),
            innovations(self.filters[1].gains, _padded(np.diff(rate, axis=0)), recorded.torque / inertia, dt),
        ]
        first = round(SETTLED / dt)
        v = np.stack([each[first:] for each in found])
        best = np.zeros((3, *v.shape[1:]))
        precision = np.array([1.0 / each.variance[-1] for each in self.filters])
        for sensor, signature in self.signatures():
            weights = signature * precision[:, None]
            size, sums = np.cumsum((weights * signature).sum(axis=0)), np.zeros(v.shape[1:])
            for row, (a, b) in enumerate(weights.T.tolist()):
                rows = v.shape[1] - row
                sums[:rows] += a * v[0, row:] + b * v[1, row:]
                np.maximum(
                    best[sensor, row:], sums[:rows] ** 2 / max(size[row], 1e-30), out=best[sensor, row:]
                )
        said = np.zeros(rate.shape, np.int8)
        said[first:] = _decide(best)
        return said


def _padded(rows: Floats) -> Floats:
    return np.concatenate([np.zeros_like(rows[:1]), rows])


def _decide(best: Floats) -> Words:
    """Name a sensor where it leads, from then on; ambiguous where one does, but not clearly."""
    other, attitude, gyro = best
    alarm = np.maximum(attitude, gyro) > np.maximum(LEVEL, other)
    lead = [a - np.maximum(b, other) > MARGIN for a, b in ((attitude, gyro), (gyro, attitude))]
    named = [np.cumsum(alarm & each, axis=0) > 0 for each in lead]
    earlier = np.cumsum(named[0], axis=0) >= np.cumsum(named[1], axis=0)
    sensor = np.where(named[0] & earlier, ATTITUDE, np.where(named[1], GYRO, NOTHING))
    return np.where(sensor > 0, sensor, np.where(alarm, AMBIGUOUS, NOTHING)).astype(np.int8)


def judge_by(law: Any, recorded: Recorded) -> Words:
    """Say of each row, flight and axis what a fault observer names, all flights at once."""
    state, said = None, []
    for row, torque in enumerate(recorded.torque):
        inputs = FaultObserverInputs(ImuSample(*[each[row] for each in recorded.imu]), torque)
        start = state is None
        state, estimate = law.step(
            law.init(inputs) if start else state, inputs, 0.0 if start else recorded.dt
        )
        pair = [getattr(estimate.sensors, name) for name in ("attitude", "gyro")]
        alarm = [np.isin(each.state, ALARMS) for each in pair]
        sure = [each & ~of.ambiguous for each, of in zip(alarm, pair, strict=True)]
        word = np.where(
            sure[0], ATTITUDE, np.where(sure[1], GYRO, np.where(alarm[0] | alarm[1], AMBIGUOUS, 0))
        )
        said.append(word)
    return np.array(said, np.int8)


def row_of(
    kind: str, by: str, said: Words, sensor: int, axes: NDArray[np.int64], dt: float
) -> tuple[str, ...]:
    """Sum up what is said of the flights with one kind of fault; without one, any word is wrong."""
    after = said[round((ONSET if sensor else SETTLED) / dt) :]
    right = (after == sensor) & (np.arange(3) == axes[:, None]) & (sensor != NOTHING)
    wrong = ((after == ATTITUDE) | (after == GYRO)) & ~right
    named = right.any(axis=(0, 2))
    unsure = (after == AMBIGUOUS).any(axis=(0, 2)) & ~named & ~wrong.any(axis=(0, 2))
    delays = right.any(axis=2).argmax(axis=0)[named] * dt
    times = (float(np.median(delays)), float(np.max(delays))) if len(delays) else (None, None)
    shares = [write_per_cent((float(np.mean(each)),)) for each in (named, wrong.any(axis=(0, 2)), unsure)]
    return (kind, by, *(["-", *shares[1:]] if not sensor else shares), write_times(times))


def compare(flights: int) -> str:
    """Return the table of every kind of fault by both."""
    recorded = record(flights)
    scenario = load_scenario(SCENARIO)
    law = fault_observer_from({"vehicle": scenario.vehicle, "observer": "isolating"})
    bank = Bank.of(scenario.sensor, len(recorded.torque), recorded.dt)
    rows, rng = list[tuple[str, ...]](), np.random.default_rng(24)
    for kind, (sensor, low, high, power) in FAULTS.items():
        axes = rng.integers(3, size=flights)
        sizes = rng.uniform(low, high, flights) * rng.choice([-1.0, 1.0], flights)
        faulty = with_faults(recorded, sensor, sizes[:, None] * (np.arange(3) == axes[:, None]), power)
        for by, said in (
            ("`isolating`", judge_by(law, faulty)),
            ("likelihood ratios", bank.judge(faulty, law.vehicle.inertia)),
        ):
            rows.append(row_of(kind, by, said, sensor, axes, recorded.dt))
    return markdown(HEAD, rows)


def main() -> int:
    """Fly, compare, and write the table into docs/isolating.md."""
    parser = argparse.ArgumentParser(description="Likelihood ratios beside isolating: docs/isolating.md.")
    parser.add_argument("--flights", type=int, default=50, help="healthy flights to which faults are added")
    parser.add_argument("--docs", type=Path, required=True, help="directory of isolating.md")
    options = parser.parse_args()
    publish(options.docs / "isolating.md", {"likelihood": compare(options.flights)}, {})
    return 0


if __name__ == "__main__":
    sys.exit(main())
