# pyright: basic
"""The attitude estimator node: makes imu/data of the raw samples of a driver that gives no orientation.

Inputs: imu/data_raw; imu/mag, if there is a magnetometer; mocap/pose, if there is a motion capture, which
sees the attitude of the IMU itself (a stamp may be up to 0.5 s late).
Outputs: imu/data, with the covariance of its orientation about the earth's axes.
Services: ~/reset (std_srvs/Trigger). A sample whose stamp repeats or goes back is refused and counted.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any

import numpy as np

from quadftc_fdi.attitude_estimator import AttitudeEstimator, EstimatorParameters
from quadftc_model.samples import ImuSample
from quadftc_ros.conversions import Floats
from quadftc_ros.diagnostics import OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_ros.wire import ImuWire, attitude_of, field_of, imu_of


class AttitudeEstimatorNode(GraphNode):
    """An attitude estimator on the stream of raw IMU samples."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("attitude_estimator", **kwargs)
        self.settings.declare(EstimatorParameters, read_only=True)
        names = [field.name for field in dataclasses.fields(EstimatorParameters)]
        values = self.settings.values()
        self._estimator = AttitudeEstimator(EstimatorParameters(*(values[name] for name in names)))
        self._publish, self._message = self.publishes("imu/data"), ImuWire(self.imu_frame)
        self._stamp_ns = -1
        self._std_devs: Floats | None = None  # of the last attitude [rad]
        self.driven_by("imu/data_raw", self._on_sample, restart=self._restart, decode=imu_of)
        self.reads("imu/mag", self._on_field, decode=field_of)
        self.reads("mocap/pose", self._on_pose, decode=attitude_of)
        self.ready()

    def _restart(self) -> None:
        self._estimator.restart()
        self._stamp_ns = -1

    def _on_field(self, stamp_ns: int, field: Floats) -> None:
        if not self._estimator.take_field(field):
            self.diagnostics.count("imu/mag: not finite, or zero")

    def _on_pose(self, stamp_ns: int, q_xyzw: Floats) -> None:
        if not self._estimator.take_pose(stamp_ns, q_xyzw):
            self.diagnostics.count("mocap/pose: off unit length, or not within 0.5 s of the last sample")

    def _on_sample(self, stamp_ns: int, sample: ImuSample) -> None:
        if stamp_ns <= self._stamp_ns:
            self.diagnostics.count("imu/data_raw: stamp repeated or went back")
            return
        self._stamp_ns = stamp_ns
        estimate = self._estimator.step(stamp_ns, sample)
        if estimate is None:
            return
        if not estimate.sample.rate_valid:
            self.diagnostics.count("imu/data_raw: body rate absent or unusable")
        self._publish(self._message(stamp_ns, estimate.sample, estimate.variance))
        self._std_devs = np.sqrt(estimate.variance)
        self.sampled(stamp_ns)

    def report(self) -> None:
        """Report how well the attitude is known."""
        if self._std_devs is None:
            self.diagnostics.report("attitude", WARN, "waits for samples of imu/data_raw")
            return
        tilt, heading = math.degrees(self._std_devs[0]), math.degrees(self._std_devs[2])
        source = self._estimator.heading_source
        values = {"tilt_sigma_deg": f"{tilt:.2f}", "heading_sigma_deg": f"{heading:.2f}", "heading": source}
        self.diagnostics.report("attitude", OK, "estimated", **values)


main = partial(run_node, AttitudeEstimatorNode)
