"""The table of docs/attitude_estimator.md: `AttitudeEstimator` on recordings with a true orientation.

    python -m quadftc_tools.study.attitude DIR [--poses]

DIR holds rosbag2 bags of an IMU whose orientation is the truth. With ``--poses`` every 14th orientation goes
to the estimator as a pose of a motion capture.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from quadftc_fdi.attitude_estimator import AttitudeEstimator, EstimatorParameters
from quadftc_model.arrays import Quaternion, Vector
from quadftc_model.rotations import wrap
from quadftc_model.samples import ImuSample
from quadftc_replay.imu_from_bag import recording_from_bag
from quadftc_replay.imu_recording import Recording
from quadftc_tools.study.page import markdown, run_study

START = 5.0  # s; errors count from then on
POSES = 14  # samples between two poses
HEAD = (
    *("recording", "tilt, RMS [deg]", "largest", "heading, RMS", "tilt within 2 sigma"),
    "heading within 2 sigma",
)


def judge(recording: Recording, poses: bool) -> tuple[str, ...]:
    """Fly a recording; return its row of the table."""
    imu, stamp_ns = recording.imu, recording.stamp_ns
    estimator = AttitudeEstimator(EstimatorParameters())
    said: list[tuple[int, Quaternion, Vector]] = []  # row, quaternion, variance
    for k, stamp in enumerate(stamp_ns.tolist()):
        sample = ImuSample(*(part[k] for part in imu))
        estimate = estimator.step(stamp, sample)
        if estimate is None or not sample.attitude_valid:
            continue
        if poses and k % POSES == 0:
            estimator.take_pose(stamp, sample.q_xyzw)
        if stamp - stamp_ns[0] > START * 1e9:
            said.append((k, estimate.sample.q_xyzw, estimate.variance))
    rows, quaternions, variances = (np.array(each) for each in zip(*said, strict=True))
    error = Rotation.from_quat(quaternions) * Rotation.from_quat(imu.q_xyzw[rows]).inv()
    z, w = error.as_quat()[:, 2:].T
    tilt: NDArray[np.float64] = np.degrees(2.0 * np.arccos(np.clip(np.hypot(z, w), 0.0, 1.0)))
    heading = 2.0 * np.arctan2(z, w)
    heading = np.degrees(wrap(heading - (0.0 if poses else heading[0])))
    sigma = np.degrees(np.sqrt(np.asarray(variances, np.float64)))
    covered = tilt < 2.0 * np.hypot(sigma[:, 0], sigma[:, 1]), np.abs(heading) < 2.0 * sigma[:, 2]
    rms, heading_rms = (float(np.sqrt(np.mean(each**2))) for each in (tilt, heading))
    errors = (f"{each:.2f}" for each in (rms, tilt.max(), heading_rms))
    return recording.name, *errors, *(f"{100 * each.mean():.1f} %" for each in covered)


def table(directory: Path, poses: bool) -> str:
    """Return the table of all recordings below a directory."""
    bags = sorted(path for path in directory.iterdir() if path.is_dir())
    return markdown(HEAD, (judge(recording_from_bag(bag), poses) for bag in bags))


if __name__ == "__main__":
    known = {"directory": {"type": Path}, "--poses": {"action": "store_true"}}
    page = "attitude_estimator.md"
    sys.exit(run_study(page, lambda told: {"attitude": table(told.directory, told.poses)}, known))
