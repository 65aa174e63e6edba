"""Circumstances in which theory has little to fear: ten calm seconds of a Qball-X4 at 250 Hz."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_model.vehicle import load_vehicle
from quadftc_theory.conditions import Bound, Circumstances, Series

QBALL = load_vehicle("qball_x4")
DT = 0.004  # s
TIME = DT * np.arange(2500)
QUIET = np.zeros((len(TIME), 3))


def circumstances(
    disturbance: NDArray[np.float64] = QUIET, error: NDArray[np.float64] = QUIET, **changes: Any
) -> Circumstances:
    """Return the circumstances with a disturbance, the error of its estimate [rad/s²], and other changes."""

    def given(value: Any, unit: str) -> Bound:
        return Bound(value, unit, "given")

    easy = Circumstances(
        vehicle=QBALL,
        dt=DT,
        duration=10.0,
        faulty_channels=("attitude",),
        tilt=given(0.1, "rad"),
        body_rate=given(0.2, "rad/s"),
        acceleration=given((0.1, 0.1, 0.1), "rad/s^2"),
        fault=given(0.05, "rad"),
        fault_growth=given(0.01, "rad/s"),
        fault_length=given(5.0, "s"),
        gyro_bias=given(0.0, "rad/s"),
        gyro_noise=given(0.0, "rad/sqrt(s)"),
        attitude_noise=given(0.0, "rad"),
        disturbance=Series(disturbance, "rad/s^2", "given"),
        disturbance_error=Series(error, "rad/s^2", "given"),
    )
    return dataclasses.replace(easy, **changes)


def named(conditions: Any, start: str) -> Any:
    """Return the condition whose name begins so."""
    return next(item for item in conditions if item.name.startswith(start))
