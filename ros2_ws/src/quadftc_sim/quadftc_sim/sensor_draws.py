"""The random numbers of the simulated sensors, in streams of their own.

Those of turn-on bias and white noise of the IMU come from the seed of the flight. Those of its slow errors,
and those of each other sensor, have their own, so that no sensor changes the numbers of another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Flag, Vector

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

WHITE = 4  # rows of three a sample needs: attitude, gyro, accelerometer, bias random walk
SLOW = 3  # further rows where the attitude wanders: one for each correlation time
DRAWS = (WHITE + SLOW, 3)
PLACE = 3  # rows of three for the position sensor: position, velocity, slow error


class TurnOn(NamedTuple):
    """Random numbers of the IMU for a flight."""

    uniform: Vector  # (..., 3) within [-1, 1], of the gyro bias
    gyro: Array  # (..., 3, 3) standard normal, of scale and misalignment
    wander: Array  # (..., 3, 3) standard normal, of the slow error at the start


class Due(NamedTuple):
    """Which sensors measure at a sample of the IMU; None where there is no such sensor."""

    position: Flag | None
    field: Flag | None  # the magnetometer
    pressure: Flag | None  # the barometer


class FirstDraws(NamedTuple):
    """Random numbers that the sensors of a vehicle begin with; None where there is no such sensor."""

    imu: TurnOn
    position: Array  # (..., 3, 3)
    field: Array  # (..., 3)
    pressure: Array  # (..., 2)


class SampleDraws(NamedTuple):
    """Standard normal numbers of a sample; None where there is no such sensor."""

    imu: Array  # (..., 7, 3)
    position: Array  # (..., 3, 3)
    field: Array  # (..., 3)
    pressure: Array  # (..., 2)


class SensorDraws:
    """Draws the random numbers of one vehicle, in the order of the flight; ``turn_on`` are the IMU's first.

    ``seed`` is that of the flight. Streams: [seed, 0, 1] slow errors, [seed, 0, 2] position sensor,
    [seed, 0, 3] magnetometer, [seed, 0, 4] barometer, and from [seed, 1, 0] faults.
    """

    def __init__(self, seed: int) -> None:
        self._white, self._slow = np.random.default_rng(seed), np.random.default_rng([seed, 0, 1])
        self._place, self._field, self._pressure = (
            np.random.default_rng([seed, 0, stream]) for stream in (2, 3, 4)
        )
        uniform, normal = self._white.uniform(-1.0, 1.0, 3), self._slow.standard_normal((2, SLOW, 3))
        self.turn_on = TurnOn(uniform, *normal)

    def next(self, count: int, slow: bool = True) -> Float[NDArray[np.float64], "count rows 3"]:
        """Draw standard normal numbers for ``count`` samples: `DRAWS` each, or those of white noise alone."""
        white = self._white.standard_normal((count, WHITE, 3))
        if not slow:
            return white
        return np.concatenate((white, self._slow.standard_normal((count, SLOW, 3))), axis=1)

    def next_place(self, count: int) -> Float[NDArray[np.float64], "count rows 3"]:
        """Draw standard normal numbers of the position sensor for ``count`` IMU samples."""
        return self._place.standard_normal((count, PLACE, 3))

    def first(self, due: Due) -> FirstDraws:
        """Draw the numbers that sensors begin with; ``due`` says which there are."""
        return FirstDraws(
            self.turn_on,
            None if due.position is None else self.next_place(1)[0],
            None if due.field is None else self._field.standard_normal(3),
            None if due.pressure is None else self._pressure.standard_normal(2),
        )

    def sample(self, due: Due) -> SampleDraws:
        """Draw the numbers of a sample; magnetometer and barometer take some only when they measure."""
        return SampleDraws(
            self.next(1)[0],
            None if due.position is None else self.next_place(1)[0],
            None if due.field is None else _normal_if(due.field, self._field, 3),
            None if due.pressure is None else _normal_if(due.pressure, self._pressure, 2),
        )


def _normal_if(due: Flag, generator: np.random.Generator, count: int) -> Array:
    return generator.standard_normal(count) if due else np.zeros(count)
