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
from quadftc_model.samples import ImuSample
from quadftc_replay.imu_from_bag import recording_from_bag
from quadftc_replay.imu_recording import Recording

START = 5.0  # s; errors count from then on
POSES = 14  # samples between two poses


def judge(recording: Recording, poses: bool) -> str:
    """Fly a recording; return its row of the table."""
    imu, stamp_ns = recording.imu, recording.stamp_ns
    estimator = AttitudeEstimator(EstimatorParameters())
    rows: list[int] = []
    quaternions: list[NDArray[np.float64]] = []
    variances: list[NDArray[np.float64]] = []
    for k, stamp in enumerate(stamp_ns.tolist()):
        sample = ImuSample(*(part[k] for part in imu))
        estimate = estimator.step(stamp, sample)
        if estimate is None:
            continue
        if poses and k % POSES == 0 and sample.attitude_valid:
            estimator.take_pose(stamp, sample.q_xyzw)
        if sample.attitude_valid and stamp - stamp_ns[0] > START * 1e9:
            rows.append(k)
            quaternions.append(np.asarray(estimate.sample.q_xyzw))
            variances.append(np.asarray(estimate.variance))
    error = Rotation.from_quat(quaternions) * Rotation.from_quat(imu.q_xyzw[rows]).inv()
    z, w = error.as_quat()[:, 2:].T
    tilt: NDArray[np.float64] = np.degrees(2.0 * np.arccos(np.clip(np.hypot(z, w), 0.0, 1.0)))
    heading = np.degrees(np.unwrap(2.0 * np.arctan2(z, w)))
    heading = heading - (0.0 if poses else heading[0])
    heading = (heading + 180.0) % 360.0 - 180.0
    sigma = np.degrees(np.sqrt(np.array(variances)))
    covered = tilt < 2.0 * np.hypot(sigma[:, 0], sigma[:, 1])
    heading_covered = np.abs(heading) < 2.0 * sigma[:, 2]
    rms, heading_rms = (float(np.sqrt(np.mean(each**2))) for each in (tilt, heading))
    shares = f"{100 * covered.mean():.1f} % | {100 * heading_covered.mean():.1f} %"
    return f"{rms:.2f} deg | {tilt.max():.2f} deg | {heading_rms:.2f} deg | {heading[-1]:.2f} deg | {shares}"


def main() -> None:
    """Print the table."""
    poses = "--poses" in sys.argv
    directory = Path(next(each for each in sys.argv[1:] if not each.startswith("-")))
    print("| recording | tilt, RMS | largest | heading, RMS | at the end | tilt within 2 sigma | heading |")
    print("|---|---|---|---|---|---|---|")
    for bag in sorted(path for path in directory.iterdir() if path.is_dir()):
        print(f"| {bag.name} | {judge(recording_from_bag(bag), poses)} |", flush=True)


if __name__ == "__main__":
    main()
