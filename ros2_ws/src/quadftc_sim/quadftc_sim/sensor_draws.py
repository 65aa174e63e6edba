"""The random numbers of the simulated sensors, in streams of their own.

Those of turn-on bias and white noise of the IMU come from the seed of the flight. Those of its slow errors,
and those of each other sensor, have their own, so that no sensor changes the numbers of another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Vector

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

WHITE = 4  # rows of three a sample needs: attitude, gyro, accelerometer, bias random walk
SLOW = 3  # further rows where the attitude wanders: one for each correlation time
DRAWS = (WHITE + SLOW, 3)
PLACE = 3  # rows of three for the position sensor: position, velocity, slow error


class TurnOn(NamedTuple):
    """Random numbers of a flight."""

    uniform: Vector  # (3,) within [-1, 1], of the gyro bias
    gyro: Array  # (3, 3) standard normal, of scale and misalignment
    wander: Array  # (3, 3) standard normal, of the slow error at the start


class SensorDraws:
    """Draws the random numbers of one IMU, in the order of the flight; ``turn_on`` are those it begins with.

    ``seed`` is that of the flight. The slow stream is [seed, 0, 1], that of the position sensor [seed, 0, 2],
    of the magnetometer [seed, 0, 3], of the barometer [seed, 0, 4]; faults count from [seed, 1, 0].
    """

    def __init__(self, seed: int) -> None:
        self._white, self._slow = np.random.default_rng(seed), np.random.default_rng([seed, 0, 1])
        self._place, self._field, self._pressure = (
            np.random.default_rng([seed, 0, stream]) for stream in (2, 3, 4)
        )
        uniform, normal = self._white.uniform(-1.0, 1.0, 3), self._slow.standard_normal((2, SLOW, 3))
        self.turn_on = TurnOn(uniform, *normal)

    def next(self, count: int, slow: bool) -> Float[NDArray[Any], "count rows 3"]:
        """Draw standard normal numbers for ``count`` samples: `DRAWS` each, or those of white noise alone."""
        white = self._white.standard_normal((count, WHITE, 3))
        if not slow:
            return white
        return np.concatenate((white, self._slow.standard_normal((count, SLOW, 3))), axis=1)

    def next_place(self, count: int) -> Float[NDArray[Any], "count rows 3"]:
        """Draw standard normal numbers of the position sensor for ``count`` IMU samples."""
        return self._place.standard_normal((count, PLACE, 3))

    def next_field(self) -> Vector:
        """Draw standard normal numbers (3,) for a sample of the magnetometer, or its start."""
        return self._field.standard_normal(3)

    def next_pressure(self) -> Vector:
        """Draw standard normal numbers (2,) for a sample of the barometer, or its start."""
        return self._pressure.standard_normal(2)
