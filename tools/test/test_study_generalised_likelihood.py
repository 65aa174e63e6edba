"""The bank of likelihood ratios: what it says of faults whose answer is known."""

import numpy as np
import pytest

from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import ImuSample
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.sensors import ImuSensor
from quadftc_tools.study.generalised_likelihood import (
    ATTITUDE,
    DEG,
    GYRO,
    NOTHING,
    ONSET,
    Bank,
    Recorded,
    with_faults,
)

DT, ROWS = 0.004, 2250
SENSOR = ImuSensor(attitude_noise=0.1 * DEG, gyro_noise=0.007 * DEG)


def hovering(flights=2):
    """Samples of vehicles at rest, level, as their sensors see them."""
    rng, shape = np.random.default_rng(5), (ROWS, flights)
    angles, rate = (scale * rng.standard_normal((*shape, 3)) for scale in (0.1 * DEG, 0.0019))
    there, force = np.ones(shape, dtype=bool), np.zeros((*shape, 3))
    imu = ImuSample(quaternion_from_euler(angles), rate, force, there, there, there)
    return Recorded(imu, np.zeros((*shape, 3)), DT)


@pytest.mark.parametrize(("sensor", "size"), [(GYRO, 0.2), (GYRO, -0.05), (ATTITUDE, 2.0 * DEG)])
def test_a_step_is_named_on_its_axis_and_flight_at_once(sensor, size):
    sizes = np.array([[0.0, size, 0.0], [0.0, 0.0, 0.0]])
    faulty = with_faults(hovering(), sensor, sizes, 0)
    said = Bank.of(SENSOR, ROWS, DT).judge(faulty, load_vehicle("qball_x4").inertia)
    onset = round(ONSET / DT)
    assert np.all(said[:onset] == NOTHING)
    assert np.all(said[onset + 2 :, 0, 1] == sensor)
    said[:, 0, 1] = NOTHING
    assert np.all(said == NOTHING)


def test_a_torque_that_turns_the_vehicle_is_no_fault():
    """A step of the unknown acceleration moves attitude and gyro together."""
    healthy = hovering(1)
    elapsed = np.maximum(np.arange(ROWS) * DT - ONSET, 0.0)[:, None, None] * np.array([1.0, 0.0, 0.0])
    noise = healthy.imu.q_xyzw[..., :3] * 2.0
    imu = healthy.imu._replace(
        q_xyzw=quaternion_from_euler(noise + 0.5 * 0.3 * elapsed**2),
        body_rate=healthy.imu.body_rate + 0.3 * elapsed,
    )
    said = Bank.of(SENSOR, ROWS, DT).judge(healthy._replace(imu=imu), load_vehicle("qball_x4").inertia)
    assert not np.any((said == ATTITUDE) | (said == GYRO))
