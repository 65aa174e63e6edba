"""Logs of simulated flights, as fast as the loop: what sensors and estimators of an autopilot would say.

The closed loop flies in free flight. Its samples get the errors that a default log is full of. Two IMUs have
bias and noise of their own, and vibration at the speeds of the rotors, which is aliased. The receiver of
satellites lags and wanders, two magnetometers are near currents, the battery sags. There is a barometer.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter  # type: ignore[import-untyped]

from quadftc_control.guidance import GuidanceOutput
from quadftc_flight.closed_loop import LoopFlyer, loop_of
from quadftc_flight.loop import LoopOutput
from quadftc_model.rotations import to_body
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.readers import read_log
from quadftc_replay.writers import WRITERS
from quadftc_sim.assembly import sample_count
from quadftc_tools.study.random_flights import RATE, Loss, RandomFlight, draw_flight

Floats = NDArray[np.float64]
FIELD = (180.0, 430.0)  # mG; horizontal and downwards, as in central Europe
CELLS = 4
SATELLITES = 5.0  # Hz


class Flown(NamedTuple):
    """A flight, a row for each sample of the IMU; n rows."""

    rate: Floats  # (n, 3) true [rad/s]
    measured: Floats  # (n, 3) by the gyro that flies the vehicle [rad/s]
    force: Floats  # (n, 3) true [m/s²]
    attitude: Floats  # (n, 4) measured, body to earth
    true_attitude: Floats  # (n, 4)
    position: Floats  # (n, 3) [m]
    velocity: Floats  # (n, 3) [m/s]
    estimated: Floats  # (n, 9) position, velocity, acceleration
    speeds: Floats  # (n, rotors) [rad/s]
    commands: Floats  # (n, rotors) shares of the greatest thrust


def fly_log(seed: int, seconds: float, loss: Loss | None = None) -> tuple[RandomFlight, FlightLog]:
    """Fly a random vehicle; return what was flown, and its log."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        flight = draw_flight(rng, seconds, Path(folder), loss)
    return flight, log_of(flight, fly(flight), rng)


def as_logged(log: FlightLog) -> Iterator[tuple[str, FlightLog]]:
    """Yield a log as each autopilot writes it by default, read back, by the name of the writer."""
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        for name, write in WRITERS.items():
            path = Path(folder, name)
            write(log, path)
            yield name, read_log(path)


def fly(flight: RandomFlight) -> Flown:
    """Fly in C."""
    scenario = flight.scenario
    loop, count = loop_of(scenario, scenario.scheme(None)), sample_count(scenario.duration, scenario.rate)
    parts = [_columns(output) for _, output in LoopFlyer().fly(loop, scenario.seed, count)]
    columns = [np.concatenate(each) for each in zip(*parts, strict=True)]
    late = loop.vehicle.imu.delay  # samples; what was measured comes later than the truth
    full = flight.vehicle.rotors.speed_max
    true, said = [each[: count - late] for each in columns[:5]], [each[late:] for each in columns[5:]]
    rate, true_attitude, position, velocity, speeds = true
    measured, force, attitude, *estimated, commands = said
    shares = np.clip((commands / full) ** 2, 0.0, 1.0)
    estimates = np.concatenate(estimated, axis=1)
    return Flown(
        rate, measured, force, attitude, true_attitude, position, velocity, estimates, speeds, shares
    )


def _columns(output: LoopOutput) -> tuple[Floats, ...]:
    """The truth, and what was said, of a block; copies, as the next block is written over it."""
    motion, sample, said = output.motion, output.faulty.sample, output.said
    space, guided = motion.flight, said.guidance
    assert space is not None
    assert isinstance(guided, GuidanceOutput)
    estimate = guided.estimate
    wanted = (
        *(motion.body_rate, space.q_xyzw, space.position, space.velocity, space.speeds),
        *(sample.body_rate, sample.specific_force, sample.q_xyzw),
        *(estimate.position, estimate.velocity, estimate.acceleration, said.attitude.said.speeds),
    )
    return tuple(np.array(each) for each in wanted)


def log_of(flight: RandomFlight, flown: Flown, rng: np.random.Generator) -> FlightLog:
    """Put errors of sensors on a flight, and log it."""
    time = np.arange(len(flown.rate), dtype=np.float64) / RATE
    load = flown.commands.mean(axis=1, keepdims=True)
    shaking, level = _vibration(flown.speeds, rng)
    gyro_noise, force_noise = 10.0 ** rng.uniform(-3.0, -2.0), 10.0 ** rng.uniform(-1.7, -0.7)

    def noisy(value: Floats, sigma: float, bias: float = 0.0) -> Floats:
        offset = bias * rng.uniform(-1.0, 1.0, int(value.shape[1]))
        return value + offset + sigma * rng.standard_normal(value.shape)

    def every(value: Floats, rate: float) -> Signal:
        rows = slice(None, None, round(RATE / rate))
        return Signal(time[rows], value[rows])

    rates = {"": noisy(flown.measured, gyro_noise), "1": noisy(flown.rate, gyro_noise, 0.01)}
    forces = {name: noisy(flown.force, force_noise, 0.15) for name in rates}
    gyro_share = 10.0 ** rng.uniform(-2.5, -1.5)  # s/m; rotation that comes with the shaking
    field = _field(flown, load, rng)
    height = flown.position[:, 2:] + _wander(len(time), 0.5, 40.0, 1, rng)
    voltage = 4.15 * CELLS - 0.12 * CELLS * time[:, None] / 60.0 - rng.uniform(0.5, 2.5) * load
    position, velocity, status = _satellites(flown, time, rng)
    has_speeds = rng.random() < 0.5
    return FlightLog(
        path=Path("simulated"),
        format="simulated",
        gyros={name: Signal(time, value + gyro_share * shaking) for name, value in rates.items()},
        accelerometers={name: Signal(time, value + shaking) for name, value in forces.items()},
        magnetometers={name: every(noisy(field, 3.0, 20.0), 50.0) for name in rates},
        barometers={"": every(noisy(height, rng.uniform(0.02, 0.2)), 50.0)},
        gps_positions={"": position},
        gps_velocities={"": velocity},
        gps_status={"": status},
        attitude=Signal(time, flown.attitude),
        attitude_from_gyro=True,
        position=Signal(time, flown.estimated[:, :3]),
        velocity=Signal(time, flown.estimated[:, 3:6]),
        acceleration=Signal(time, flown.estimated[:, 6:]),
        rotor_speeds=Signal(time, flown.speeds) if has_speeds else None,
        rotor_commands=Signal(time, flown.commands),
        battery=every(noisy(voltage, 0.02), 20.0),
        vibration=every(level, 20.0),
        rotor_positions=flight.layout.positions,
        rotor_yaw_signs=flight.layout.yaw_signs,
    )


def _vibration(speeds: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """What rotors out of balance shake (n, 3), and its root mean square before the filters (n, 1) [m/s²]."""
    size, passed = 10.0 ** rng.uniform(-1.5, 0.5), rng.uniform(0.1, 0.5)
    rotors, phase = int(speeds.shape[1]), np.cumsum(speeds, axis=0) / RATE
    share = rng.uniform(0.2, 1.0, rotors) * np.square(speeds / float(speeds.mean()))
    shaking = np.zeros((len(speeds), 3))
    for harmonic in (1.0, 2.0):
        direction = rng.standard_normal((rotors, 3)) / harmonic
        begin = rng.uniform(0.0, 2.0 * np.pi, rotors)
        shaking += size * (share * np.sin(harmonic * phase + begin)) @ direction
    square = np.mean(np.square(shaking), axis=1)
    window = np.full(round(RATE), 1.0)
    level = np.sqrt(np.convolve(square, window, "same") / np.convolve(np.ones(len(square)), window, "same"))
    return shaking, level[:, None] / passed


def _field(flown: Flown, load: Floats, rng: np.random.Generator) -> Floats:
    """Field of the earth in body axes, with that of the currents (n, 3) [mG]."""
    declination = rng.uniform(-0.3, 0.3)
    north, down = FIELD
    earth = np.array([north * np.sin(declination), north * np.cos(declination), -down])
    turned = np.asarray(to_body(flown.true_attitude, np.broadcast_to(earth, (len(load), 3))))
    return turned + rng.uniform(-15.0, 15.0, 3) * load


def _satellites(flown: Flown, time: Floats, rng: np.random.Generator) -> tuple[Signal, Signal, Signal]:
    """Position, velocity and status by a receiver, late."""
    rows = np.arange(0, len(time), round(RATE / SATELLITES))
    late = np.maximum(rows - round(rng.uniform(0.05, 0.25) * RATE), 0)
    count, scale = len(rows), rng.uniform(0.3, 1.5)
    wander = scale * _wander(count, 1.0, 60.0, 3, rng, SATELLITES) * [1.0, 1.0, 1.5]
    noise = scale * rng.standard_normal((2, count, 3)) * [1.0, 1.0, 2.0]
    status = np.tile([3.0, float(rng.integers(8, 20)), 1.2 * scale], (count, 1))
    position = flown.position[late] + wander + 0.02 * noise[0]
    velocity = flown.velocity[late] + 0.05 * noise[1]
    return Signal(time[rows], position), Signal(time[rows], velocity), Signal(time[rows], status)


def _wander(
    count: int, size: float, seconds: float, width: int, rng: np.random.Generator, rate: float = RATE
) -> Floats:
    """A slow error (count, width): a first-order Gauss-Markov process."""
    keep = float(np.exp(-1.0 / (seconds * rate)))
    driven = size * np.sqrt(1.0 - keep**2) * rng.standard_normal((count, width))
    driven[0] = size * rng.standard_normal(width)
    return cast("Floats", lfilter([1.0], [1.0, -keep], driven, axis=0))
