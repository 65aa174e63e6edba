"""Which studies there are: what each varies, what its tables show, what its figure."""

from __future__ import annotations

from typing import NamedTuple

VARIANTS = (
    *("proposed", "supervised", "augmented_kalman", "edwards_spurgeon", "threshold", "conventional"),
)  # schemes of campaigns/scenarios/robustness.yaml
GRADES = {"ideal": "ideal sensors", "mems": "MEMS IMU"}


class Shown(NamedTuple):
    """A metric of a whole flight that a study shows, the worst axis of each flight."""

    key: str  # of its table
    title: str
    metric: str  # without the axis
    drawn: bool = True  # in the figure, too


class Study(NamedTuple):
    """A campaign over a grid of one value, and perhaps of the grade of the sensors."""

    name: str  # campaigns/study_NAME.yaml
    path: str  # of the value
    title: str  # of its axis, with the unit
    shown: tuple[Shown, ...]


class Sized(NamedTuple):
    """A kind of fault of the study of sizes."""

    kind: str
    path: str  # of its size
    title: str  # of its axis, with the unit
    edges: tuple[float, ...]  # of the bins of its table


TRACKING = Shown("tracking", "tracking RMSE [deg]", "tracking_rmse_deg")
ESTIMATE = Shown("estimate", "fault estimate RMSE [deg]", "fault_estimate_rmse_deg")
DISTURBANCE = Shown(
    "disturbance", "disturbance estimate RMSE [rad/s²]", "disturbance_estimate_rmse", drawn=False
)
CHATTER = Shown("torque", "torque variation [N m/s]", "torque_total_variation")

STUDIES = (
    Study(
        "inertia",
        "plant.inertia_factor",
        "inertia of the vehicle over that of the model",
        (TRACKING, ESTIMATE, DISTURBANCE),
    ),
    Study("motor_lag", "plant.motor_bandwidth", "bandwidth of the motors [rad/s]", (TRACKING, ESTIMATE)),
    Study("gyro", "sensors.gyro_bias", "largest gyro bias [deg/s]", (TRACKING, ESTIMATE)),
    Study("rate", "rate", "rate [Hz]", (TRACKING, ESTIMATE, CHATTER)),
)

SIZES = "fault_size"  # campaigns/study_fault_size.yaml
DEGREES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
SIZED = (
    Sized("step", "faults.0.value", "step [deg]", DEGREES),
    Sized("sine", "faults.1.amplitude", "amplitude of the sine [deg]", DEGREES),
    Sized("ramp", "faults.2.rate", "slope of the ramp [deg/s]", tuple(each / 10.0 for each in DEGREES)),
)
