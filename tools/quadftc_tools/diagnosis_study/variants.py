"""Which observers are flown, with which parameters.

This and `criteria` are apart from `settings`: to change them makes no flight anew.
"""

from __future__ import annotations

from quadftc_sim.sensors import GRADES
from quadftc_tools.diagnosis_study.settings import GRADE, Setting, Variant

OBSERVERS = ("sliding_mode", "augmented_kalman", "edwards_spurgeon", "threshold", "supervised")
ISOLATED = "supervised"  # flown with faults on one axis at a time
SWEPT: dict[str, tuple[str, tuple[float, ...]]] = {
    "supervised": ("threshold", (3.0, 3.7, 4.5, 6.5, 8.0, 12.0)),  # 1
    "threshold": ("angle_threshold", (0.002, 0.005, 0.02, 0.05, 0.1)),  # rad
}  # observer -> the parameter that is its level, and its values beside the default


def variants_of(setting: Setting, swept: bool) -> tuple[Variant, ...]:
    """Return the observers of a setting, and if asked those with other levels, for the ROC."""
    if setting.one_axis:
        return (_variant(setting, ISOLATED),)
    usual = tuple(_variant(setting, name) for name in OBSERVERS)
    levels = tuple(
        _variant(setting, name, parameter, value)
        for name, (parameter, values) in SWEPT.items()
        for value in values
        if swept
    )
    return (*usual, *levels)


def _variant(setting: Setting, observer: str, parameter: str = "", value: float = 0.0) -> Variant:
    known = () if setting.recorded else _known_noise(observer)
    if not parameter:
        return Variant(observer, observer, known)
    return Variant(f"{observer}@{value:g}", observer, (*known, (parameter, value)))


def _known_noise(observer: str) -> tuple[tuple[str, float], ...]:
    """Parameters of observers that take the figures of the sensors, which the simulation knows."""
    grade = GRADES[GRADE]
    noise = tuple((name, float(grade[name])) for name in ("attitude_noise", "gyro_noise", "gyro_bias_walk"))
    absent = ("wander", "wander_moving", "gyro_moving", "gyro_shift", "gyro_scale", "delay")
    return {"supervised": (*noise, *((name, 0.0) for name in absent)), "augmented_kalman": noise}.get(
        observer, ()
    )
