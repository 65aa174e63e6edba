"""What is asked of an observer, and the sizes by which faults are counted, for each setting."""

from __future__ import annotations

from typing import NamedTuple

from quadftc_tools.diagnosis_study.settings import Setting


class Criteria(NamedTuple):
    """Bounds that an observer has to reach; no fault may be missed."""

    step_max_s: float
    ramp_median_s: float
    sine_median_s: float
    rmse_median_deg: float
    rmse_p95_deg: float  # beyond, a fault is badly estimated
    false_alarm_share: float  # of healthy time
    bins: dict[str, tuple[float, ...]]  # kind -> edges of its sizes [deg, deg/s]


_SIMULATED = Criteria(
    step_max_s=0.02,
    ramp_median_s=0.5,
    sine_median_s=0.12,
    rmse_median_deg=0.08,
    rmse_p95_deg=0.25,
    false_alarm_share=0.0,
    bins={"step": (0.5, 1.0, 2.0, 5.0), "ramp": (0.05, 0.1, 0.2, 0.5), "sine": (1.0, 1.5, 2.0, 3.0)},
)
_RECORDED = Criteria(
    step_max_s=0.05,
    ramp_median_s=3.0,
    sine_median_s=0.6,
    rmse_median_deg=0.5,
    rmse_p95_deg=1.5,
    false_alarm_share=0.005,
    bins={"step": (3.0, 5.0, 7.0, 10.0), "ramp": (0.2, 0.4, 0.7, 1.0), "sine": (3.0, 4.0, 5.0, 6.0)},
)


def criteria_of(setting: Setting) -> Criteria:
    """Return the criteria of a setting."""
    return _RECORDED if setting.recorded else _SIMULATED
