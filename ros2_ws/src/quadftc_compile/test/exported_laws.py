"""Laws that are exported in tests, with samples for them."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from small_laws import LowPass, State

from quadftc_compile.export import FLAGS, Exported, export_of, write_example, write_law
from quadftc_compile.recipe import recipe_of
from quadftc_compile.samples import write_samples
from quadftc_model.arrays import Array, Flag, Scalar, Vector, arcsin, arctan2, cos, exp, log, sin, sqrt, tan
from quadftc_model.parameters import Checked, parameter
from quadftc_model.position_estimator import PositionEstimator, PositionEstimatorInputs
from quadftc_model.samples import NO_PLACE, PositionSample, level_sample

WARNINGS = ("-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror")
COUNT = 60  # samples


class TaggedInputs(NamedTuple):
    """Numbers of all kinds."""

    value: Vector  # [rad]
    there: Flag
    channel: Array  # uint8
    shift: Array  # int32


class TaggedOutput(NamedTuple):
    """Numbers of all kinds."""

    mean: Vector  # [rad]
    low: Flag
    channel: Array  # uint8
    shifts: Array  # int32, sum of all


class TaggedState(NamedTuple):
    """A mean and a sum."""

    filtered: State
    shifts: Array


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Tagged(LowPass):
    """A low-pass filter that passes whole numbers on."""

    def example(self) -> TaggedInputs:
        """Return inputs as it takes them."""
        return TaggedInputs(np.zeros(3), np.bool_(True), np.uint8(0), np.int32(0))

    def init(self, inputs: TaggedInputs) -> TaggedState:
        """Start at the value."""
        return TaggedState(super().init(inputs), 0 * inputs.shift)

    def step(self, state: TaggedState, inputs: TaggedInputs, dt: Scalar) -> tuple[TaggedState, TaggedOutput]:
        """Follow the value, and add up."""
        filtered, mean = super().step(state.filtered, inputs, dt)
        shifts = state.shifts + inputs.shift
        return TaggedState(filtered, shifts), TaggedOutput(mean, mean[0] < 0.0, inputs.channel, shifts)


class Wave(NamedTuple):
    """Angles and a size."""

    angles: Vector  # [rad]
    size: Scalar


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Waves(Checked):
    """Takes all that laws take of libm; a state that is not finite would stay so."""

    rate: float = parameter(3.0, unit="rad/s", doc="how fast the angles turn")

    def example(self) -> Wave:
        """Return inputs as it takes them."""
        return Wave(np.zeros(3), np.float64(1.0))

    def init(self, inputs: Wave) -> Wave:
        """Start at the inputs."""
        return inputs

    def step(self, state: Wave, inputs: Wave, dt: Scalar) -> tuple[Wave, Wave]:
        """Turn by the rate and the inputs."""
        turned = state.angles + self.rate * dt + inputs.angles
        angles = arctan2(sin(turned), cos(turned))
        size = exp(0.5 * log(1.0 + state.size * state.size + inputs.size * inputs.size) - 0.1)
        tilt = arcsin(0.99 * sin(angles[..., 0])) * sqrt(size) + tan(0.3 * angles[..., 1])
        return Wave(angles, size), Wave(angles * size, tilt)


def exported_waves(real: str = "double") -> Exported:
    """Return a law that takes all that laws take of libm."""
    law = Waves()
    return export_of(recipe_of(law, law.example()), real)


def wave_samples() -> tuple[np.ndarray, Wave]:
    """Return time steps and inputs."""
    random = np.random.default_rng(5)
    return np.full(COUNT, 0.01), Wave(random.normal(size=(COUNT, 3)), random.normal(size=COUNT))


def exported_estimator(real: str = "double") -> Exported:
    """Return a law with a covariance, branches and constants."""
    law = PositionEstimator(gives_velocity=True, delay=0.05)
    return export_of(recipe_of(law, PositionEstimatorInputs(level_sample(), NO_PLACE)), real)


def estimator_samples() -> tuple[np.ndarray, PositionEstimatorInputs]:
    """Return time steps and inputs, which place it by vehicle and time; it begins at two of them."""
    random = np.random.default_rng(4)
    imu = level_sample()._replace(specific_force=random.normal([0.0, 0.0, 9.81], 1.0, (COUNT, 3)))
    place = PositionSample(
        1e-3 * random.normal(size=(COUNT, 3)), np.zeros((COUNT, 3)), random.random(COUNT) < 0.5
    )
    dt = np.full(COUNT, 0.004)
    dt[[0, 40]] = 0.0
    return dt, PositionEstimatorInputs(imu, place)


def written(exported: Exported, folder: Path) -> Path:
    """Write a law with its example."""
    write_law(exported, folder)
    write_example(exported, folder)
    return folder


def write_inputs(exported: Exported, path: Path, dt: Sequence[float], inputs: object) -> Path:
    """Write samples for a law."""
    write_samples(path, exported.layouts["inputs"], dt, inputs)
    return path


def built(exported: Exported, folder: Path, *more: str) -> Path:
    """Build the example of a law that is written already, with warnings as errors."""
    sources = ["main.c", f"{exported.name}.c", f"{exported.name}_numbers.c", *more]
    command = ["cc", "-std=c99", *FLAGS, *WARNINGS, *sources, "-lm", "-o", "example"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "example"


def run(program: Path, samples: Path) -> subprocess.CompletedProcess[str]:
    """Run an example."""
    return subprocess.run([program, samples], capture_output=True, text=True, check=False, timeout=60)


def table_of(said: str) -> np.ndarray:
    """Return the numbers that an example says, without those of the samples."""
    return np.array([line.split(",") for line in said.splitlines()[1:]], float)[:, 1:]
