"""The flights of the study: their samples, and the faults that are put on them.

A simulated flight is a smooth motion seen through the IMU model of `quadftc_sim`; what drives it is not
known, so the torque is zero, as on a recording without commands. Each flight has its own random numbers,
whatever other flights there are.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.diagnosis_metrics import GRACE_TIME
from quadftc_model.rotations import body_rates, quaternion_from_euler
from quadftc_model.samples import AXES, ImuSample
from quadftc_replay.imu_from_bag import recording_from_bag
from quadftc_replay.imu_recording import Recording
from quadftc_sim.assembly import EPOCH_NS, period_ns, sample_count
from quadftc_sim.sensors import DRAWS, GRADES, ImuSensor
from quadftc_tools.diagnosis_study.settings import (
    DURATION,
    EVERY,
    FAULT_TIME,
    FIRST,
    GRADE,
    RATE,
    WINDOWS,
    Ranges,
    Setting,
)

Floats = NDArray[np.float64]
Window = tuple[float, float]

SINES = 2  # of the motion of an axis
AMPLITUDE = (1.0, 4.0)  # deg, of a sine
FREQUENCY = (0.2, 1.5)  # rad/s
DECIMALS = 4  # of sizes and times, so that a fault can be written down
KINDS = {"step": "bias", "ramp": "drift", "sine": "sine"}  # word of the field -> fault of the catalogue


class FlightPlan(NamedTuple):
    """Which flight."""

    setting: Setting
    number: int  # of the flight; on recordings, of the draw of faults
    bag: Path | None = None
    bag_number: int = 0

    @property
    def name(self) -> str:
        """Unique within its setting."""
        return f"{self.number}" if self.bag is None else f"{self.bag.name}/{self.number}"


class DrawnFault(NamedTuple):
    """One fault on one axis of the attitude."""

    axis: str
    kind: str  # step, ramp, sine
    size: float  # deg; of a ramp deg/s
    frequency: float | None  # rad/s, of a sine
    start: float  # s
    stop: float  # s

    @property
    def spec(self) -> str:
        """As ``quadftc replay --fault`` takes it."""
        size = {
            "step": f"value={self.size}deg",
            "ramp": f"rate={self.size}deg/s",
            "sine": f"amplitude={self.size}deg frequency={self.frequency}",
        }[self.kind]
        return f"{KINDS[self.kind]} axis={self.axis} {size} start={self.start}s stop={self.stop}s"


def prepare(
    plan: FlightPlan, seed: int, duration: float = DURATION, windows: tuple[Window, ...] = WINDOWS
) -> tuple[Recording, tuple[DrawnFault, ...]]:
    """Return the samples of a flight without faults, and its faults in the order of time and axis.

    Parameters
    ----------
    plan : FlightPlan
    seed : int
        Of the whole study.
    duration : float
        Of a simulated flight [s].
    windows : tuple of (float, float)
        When a simulated flight is faulty [s].

    Raises
    ------
    BagError
        If the bag cannot be used.
    """
    key = (plan.setting.number, plan.bag_number, plan.number)
    of_faults, of_samples = np.random.SeedSequence(seed, spawn_key=key).spawn(2)
    generator = np.random.default_rng(of_faults)
    if plan.bag is None:
        recording = simulated(np.random.default_rng(of_samples), duration)
    else:
        recording = _recorded(plan.bag)
        windows = recording_windows(generator, recording.duration)
    return recording, draw_faults(generator, windows, plan.setting.ranges, plan.setting.one_axis)


def draw_faults(
    generator: np.random.Generator, windows: tuple[Window, ...], ranges: Ranges, one_axis: bool
) -> tuple[DrawnFault, ...]:
    """Draw a fault of random kind, size and sign for each window, on each axis or on a random one."""
    found: list[DrawnFault] = []
    for start, stop in windows:
        axes = (AXES[int(generator.integers(len(AXES)))],) if one_axis else AXES
        for axis in axes:
            kind = tuple(KINDS)[int(generator.integers(len(KINDS)))]
            bounds: tuple[float, float] = getattr(ranges, kind)
            size = round(float(generator.uniform(*bounds)), DECIMALS)
            sign = 1.0 if generator.random() < 0.5 else -1.0
            frequency = round(float(generator.uniform(*ranges.frequency)), DECIMALS)
            of_sine = frequency if kind == "sine" else None
            found.append(DrawnFault(axis, kind, sign * size, of_sine, start, stop))
    return tuple(found)


def recording_windows(generator: np.random.Generator, duration: float) -> tuple[Window, ...]:
    """Return the times of whole faults on a recording [s], each with time behind it to be over."""
    first = round(float(generator.uniform(*FIRST)), DECIMALS)
    count = max(math.floor((duration - GRACE_TIME - FAULT_TIME - first) / EVERY) + 1, 0)
    starts = [round(first + EVERY * index, DECIMALS) for index in range(count)]
    return tuple((start, round(start + FAULT_TIME, DECIMALS)) for start in starts)


def simulated(generator: np.random.Generator, duration: float = DURATION) -> Recording:
    """Simulate a healthy flight: sines on each axis, seen by an IMU with an unknown gyro bias."""
    period, count = period_ns(RATE), sample_count(duration, RATE)
    time = np.arange(count, dtype=np.float64) / RATE
    angles, rates = _motion(generator, time)
    samples = _measured(generator, quaternion_from_euler(angles), body_rates(angles, rates))
    return Recording(
        name="simulated",
        path=Path("simulated"),
        topic="/imu/data",
        namespace="/",
        stamp_ns=EPOCH_NS + period * np.arange(count, dtype=np.int64),
        imu=samples,
        torque=np.zeros((count, len(AXES))),
    )


def study_sensor() -> ImuSensor:
    """Return the IMU of the simulation; a delay is a matter of stamps, and there is nothing to delay here."""
    return ImuSensor(**{**GRADES[GRADE], "delay": 0})  # pyright: ignore[reportArgumentType]


def _motion(generator: np.random.Generator, time: Floats) -> tuple[Floats, Floats]:
    """Euler angles [rad] and their rates [rad/s] (n, 3)."""
    shape = (len(AXES), SINES)
    amplitude = np.radians(generator.uniform(*AMPLITUDE, shape))
    frequency = generator.uniform(*FREQUENCY, shape)
    phase = generator.uniform(-math.pi, math.pi, shape)
    argument = frequency * time[:, None, None] + phase
    angles = np.sum(amplitude * np.sin(argument), axis=-1)
    return angles, np.sum(amplitude * frequency * np.cos(argument), axis=-1)


def _measured(generator: np.random.Generator, q_xyzw: Floats, body_rate: Floats) -> ImuSample:
    """What the IMU makes of the motion, sample by sample; leading axis n."""
    sensor, count = study_sensor(), len(q_xyzw)
    state = sensor.init(sensor.turn_on_bias(generator.uniform(-1.0, 1.0, len(AXES))))
    draws = generator.standard_normal((count, *DRAWS))
    samples: list[ImuSample] = []
    for row in range(count):
        state, sample = sensor.step(state, q_xyzw[row], body_rate[row], draws[row], 1.0 / RATE)
        if sample is not None:
            samples.append(sample)
    return ImuSample(*(np.stack(column) for column in zip(*samples, strict=True)))


@functools.lru_cache(maxsize=2)
def _recorded(bag: Path) -> Recording:
    return recording_from_bag(bag)
