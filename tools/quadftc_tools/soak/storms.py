# pyright: basic
"""Wild samples for every fault observer, in C: a vehicle that tumbles, and readings of no vehicle at all.

Gaps, faults and torques are drawn, too. What counts: no number that is not finite comes out, and how often an
observer had to start again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.spatial.transform import Rotation

from quadftc_compile.build import build_library
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.observation import Observation, ObservationInputs
from quadftc_model.arrays import finite, rows_of
from quadftc_model.guarded import Guarded
from quadftc_model.samples import NO_PLACE, STANDARD_GRAVITY, ImuSample, RotorReading
from quadftc_model.stepper import MAX_GAP
from quadftc_model.vehicle import load_vehicle

Floats = NDArray[np.float64]
GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY])  # m/s²
PERIOD = 0.004  # s
VEHICLES = {False: "qball_x4", True: "x500"}  # on the test stand, in free flight


@dataclasses.dataclass
class Storm:
    """What came of the samples of one kind."""

    observer: str
    where: str
    storm: str
    samples: int = 0
    not_finite: int = 0
    restarts: int = 0


@dataclasses.dataclass
class Samples:
    """A sequence of samples, with the time steps [s] between them."""

    dt: Floats
    imu: ImuSample


def tumbling(rng: np.random.Generator) -> Samples:
    """Return samples of a vehicle that begins to tumble; gyro and attitude agree but for a fault."""
    count = 900
    speed, gap, fault = (
        rng.choice([0.0, 2.0, 6.0, 15.0, 40.0]),
        rng.choice([0.0, 0.02, 0.1]),
        rng.choice([0.0, 0.1, 0.5, 1.5]),
    )
    faulty, tumbles = (np.arange(count) >= begin for begin in rng.integers(50, 400, 2))
    dt = np.where(rng.random(count) < gap, rng.choice([0.012, 0.05, 0.3], count), PERIOD)
    rate = tumbles[:, None] * speed * rng.standard_normal(3)
    attitude = Rotation.from_rotvec(np.cumsum(rate * dt[:, None], axis=0))
    off = faulty[:, None] * fault * rng.integers(-1, 2, 3)
    read = Rotation.from_euler("ZYX", attitude.as_euler("ZYX") + off[:, ::-1])
    return Samples(
        dt,
        ImuSample(
            (read * Rotation.from_rotvec(0.001 * rng.standard_normal((count, 3)))).as_quat(),
            rate + 0.003 * rng.standard_normal((count, 3)),
            attitude.inv().apply(GRAVITY) + 0.03 * rng.standard_normal((count, 3)),
            *np.ones((3, count), np.bool_),
        ),
    )


STEPS = {  # s, that a style draws from; one that is not positive is refused, after a long one a law begins
    "clean": [PERIOD],
    "jitter": [1e-6, 1e-4, 0.004, 0.008, 0.03],
    "gaps": [0.004, 0.004, 0.004, 0.3, 0.9],
    "mixed": [1e-9, 0.004, 0.004, 0.1, 0.99, 2.0, -0.005, -1000.0, 1000.0],
}


def hostile(rng: np.random.Generator) -> Samples:
    """Return samples of which some are of no vehicle, not there, or no numbers."""
    count = int(rng.choice([300, 1500]))
    style, share = rng.choice([*STEPS]), rng.choice([0.0, 0.05, 0.5])
    wild = (rng.random(count) < share)[:, None]
    turned = np.maximum.accumulate(np.where(rng.random(count) < 0.002, np.arange(count), 0))
    there = rng.uniform(-0.6, 0.6, (count, 3))[turned] * (turned > 0)[:, None]
    angles = there + 0.002 * rng.standard_normal((count, 3))
    odd_angles = rng.choice([0.0, 0.5, -0.5, 1.57, 3.0, np.nan, 1e300], (count, 3))
    odd_angles = np.where(rng.random((count, 3)) < 0.2, rng.uniform(-3.0, 3.0, (count, 3)), odd_angles)
    odd_rate = rng.choice([0.0, 1.0, -20.0, 99.0, np.inf, 1e-310, 0.3], (count, 3))
    angles = np.where(wild, odd_angles, angles)
    known = np.isfinite(angles).all(axis=1) & (np.abs(angles) < 1e6).all(axis=1)
    q_xyzw = np.full((count, 4), np.nan)
    q_xyzw[known] = Rotation.from_euler("ZYX", angles[known][:, ::-1]).as_quat()
    return Samples(
        rng.choice(STEPS[style], count),
        ImuSample(
            q_xyzw,
            np.where(wild, odd_rate, 0.01 * rng.standard_normal((count, 3))),
            GRAVITY + 0.05 * rng.standard_normal((count, 3)),
            *(rng.random(count) > share for share in (0.02, 0.01, 0.005)),
        ),
    )


STORMS = {"tumbling": tumbling, "hostile": hostile}


def soak(samples: int, seed: int, follow: Callable[[Storm], None]) -> list[Storm]:
    """Throw so many samples of each kind at each fault observer, on the test stand and in free flight."""
    done: list[Storm] = []
    for observer in fault_observers.names():
        for flies in (False, True):
            law = Guarded(
                Observation(fault_observers.get(observer)(vehicle=load_vehicle(VEHICLES[flies])), flies)
            )
            runner = CRunner(law, build_library(recipe_of(law, law.example(), law.example_words())))
            for number, (name, draw) in enumerate(STORMS.items()):
                storm = Storm(observer, "free flight" if flies else "test stand", name)
                rng = np.random.default_rng([seed, number])
                while storm.samples < samples:
                    _fly(runner, draw(rng), rng, flies, storm)
                done.append(storm)
                follow(storm)
    return done


def _fly(runner: CRunner, drawn: Samples, rng: np.random.Generator, flies: bool, storm: Storm) -> None:
    """Run a law over a sequence; count what comes out."""
    inputs = _inputs(runner.law, drawn.imu, rng, flies)
    for dt, rows in _stretches(drawn.dt):
        state, output = runner.first(rows_of(inputs, rows[0]))
        _count(storm, output)
        if len(rows) > 1:
            _, outputs = runner.run(state, rows_of(inputs, rows[1:]), dt[1:])
            _count(storm, outputs)


def _inputs(law: Any, imu: ImuSample, rng: np.random.Generator, flies: bool) -> ObservationInputs:
    count = len(imu.q_xyzw)
    if not flies:
        return ObservationInputs(imu, rng.uniform(-0.3, 0.3, (count, 3)), driven=np.ones(count, np.bool_))
    vehicle = law.law.observer.vehicle
    speeds = vehicle.hover_speed * rng.uniform(0.5, 1.5, (2, count, len(vehicle.rotors.positions)))
    place = NO_PLACE._replace(
        position=rng.normal(0.0, 5.0, (count, 3)), velocity=rng.normal(0.0, 2.0, (count, 3))
    )
    return ObservationInputs(
        imu,
        rotors=RotorReading(speeds[0], speeds[1], rng.random(count) < 0.7),
        position=place._replace(there=rng.random(count) < 0.3),
        driven=np.ones(count, np.bool_),
    )


def _stretches(dt: Floats) -> Iterator[tuple[Floats, NDArray[np.int64]]]:
    """Yield time steps and rows between two begins of a law, as `quadftc_model.stepper` decides by stamps."""
    begin: list[int] = []
    steps: list[float] = []
    behind = 0.0  # the newest stamp less that of the last sample that was taken [s]
    for row, step in enumerate(dt.tolist()):
        behind += step
        if not begin or abs(behind) > MAX_GAP:
            if begin:
                yield np.array(steps), np.array(begin)
            begin, steps, behind = [row], [0.0], 0.0
        elif behind > 0.0:
            begin.append(row)
            steps.append(behind)
            behind = 0.0
    if begin:
        yield np.array(steps), np.array(begin)


def _count(storm: Storm, output: Any) -> None:
    """Count outputs (n,), or one ()."""
    failed = np.asarray(output.failed)
    storm.samples += failed.size
    storm.not_finite += int(np.sum(~np.broadcast_to(finite(output.said, failed.ndim), failed.shape)))
    storm.restarts += int(np.sum(failed))


def table(done: list[Storm]) -> Table:
    """Return a row for each storm."""
    found = Table(*("observer", "where", "samples of", "samples", "not finite", "restarts"))
    for each in done:
        found.add_row(
            *(
                f"{value:,}".replace(",", " ") if isinstance(value, int) else value
                for value in dataclasses.astuple(each)
            )
        )
    return found


def summary(done: list[Storm], seed: int) -> dict[str, Any]:
    """Return what came of all storms."""
    return {
        "seed": seed,
        "samples": sum(each.samples for each in done),
        "restarts": sum(each.restarts for each in done),
        "passed": not any(each.not_finite for each in done),
    }
