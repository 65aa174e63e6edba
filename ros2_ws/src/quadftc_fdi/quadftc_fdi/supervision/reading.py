"""A measured attitude beside the predicted ones."""

from __future__ import annotations

from typing import NamedTuple

from quadftc_fdi.supervision import anchors, measurement, sensor_noise
from quadftc_fdi.supervision.transition import FilterState
from quadftc_model.arrays import Mask, Vector, column, larger
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import ImuSample


class Reading(NamedTuple):
    """A measured attitude beside the predicted ones."""

    prediction: measurement.Prediction
    residuals: anchors.Residuals  # [rad] of the filter and the anchors
    predicted: anchors.Predicted  # variances [rad²] of the angles that these predict
    sensor: sensor_noise.Statistics  # variances [rad²] of the sensor in the tests
    valid: Mask  # measured, and can correct the filter
    testable: Mask


def compare(
    estimate: FilterState,
    earlier: anchors.Anchors,
    imu: ImuSample,
    omega: Vector,
    noise: sensor_noise.SensorNoise,
) -> Reading:
    """Compare a measured attitude with the predicted ones."""
    prediction = measurement.predict_angles(estimate, omega)
    residual = measurement.nearest_residual(prediction, euler_from_quaternion(imu.q_xyzw))
    residuals, predicted = anchors.compare_anchors(earlier, prediction, residual)
    sensor = noise.cautious * column(prediction.gain)
    variance = noise.exact[..., : sensor_noise.MIDDLE].sum(axis=-1) * prediction.gain
    masks = measurement.defined(prediction, estimate.P, variance, imu.attitude_valid)
    return Reading(prediction, residuals, predicted, sensor, *masks)


def noise_of(reading: Reading, white: Vector) -> Vector:
    """Variance [rad²] of a sample for the filter.

    ``white`` is the variance in a sample of the white noise that stands for slow errors, over that in the
    longest average.
    """
    single, long = reading.sensor[..., sensor_noise.SAMPLE], reading.sensor[..., sensor_noise.LONG]
    return larger(single, long * white)
