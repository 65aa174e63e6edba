"""The conditions of a whole scheme, in sections, and the verdict."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, cast

import numpy as np

from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Scenario, Scheme
from quadftc_model.vehicle import load_vehicle
from quadftc_theory.circumstances import circumstances, circumstances_of_run
from quadftc_theory.conditions import Circumstances, Condition, Trace, judge, judge_along
from quadftc_theory.linear_model import attitude_model
from quadftc_theory.structure_conditions import structure_conditions


@dataclasses.dataclass(frozen=True)
class Section:
    """Conditions that belong together."""

    title: str
    conditions: tuple[Condition, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class CheckReport:
    """What was found."""

    scenario: str
    scheme: str
    bag: str | None  # of the recorded run
    sections: tuple[Section, ...]
    given: Circumstances  # the bounds that were used

    @property
    def passed(self) -> bool:
        """Whether nothing fails that the scheme needs."""
        return not any(item.failed for section in self.sections for item in section.conditions)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON: no NaN, no infinity."""
        found = {
            "scenario": self.scenario,
            "scheme": self.scheme,
            "bag": self.bag,
            "passed": self.passed,
            "sections": [dataclasses.asdict(section) for section in self.sections],
            "bounds": {name: dataclasses.asdict(bound) for name, bound in self.given.bounds.items()},
        }
        return cast("dict[str, Any]", _plain(found))


def check_scenario(scenario: Scenario, scheme: Scheme, output: str = "imu") -> CheckReport:
    """Judge a scheme in a scenario, without flying it.

    Parameters
    ----------
    scenario, scheme : Scenario, Scheme
    output : str
        Output of the model (6) that is judged: ``imu``, or ``angles`` as in the paper.
    """
    return _check(scenario, scheme, circumstances(scenario, scheme), output)


def check_run(run: RecordedRun, output: str = "imu") -> CheckReport:
    """Judge the scheme of a recorded run: with the bounds of the recording, and along it."""
    given = circumstances_of_run(run)
    report = _check(run.scenario, run.scheme, given, output)
    trace = _trace(run)
    laws = (run.scheme.observer.law, run.scheme.controller.law)
    found = tuple(item for law in laws for item in judge_along(law, trace, given))
    along = (Section("along the recorded run", found),) if found else ()
    return dataclasses.replace(report, bag=str(run.path), sections=report.sections + along)


def _check(scenario: Scenario, scheme: Scheme, given: Circumstances, output: str) -> CheckReport:
    sections = [
        Section(f"{role}: {part.kind}", tuple(judge(part.law, given)))
        for role, part in (
            ("fault observer", scheme.observer),
            ("disturbance observer", scheme.disturbance_observer),
            ("controller", scheme.controller),
        )
    ]
    if output != "imu" or scheme.observer.kind != "none":
        asked = output != "imu"
        title = "the paper's own set-up, y = (roll, pitch, yaw), q = 3" + ("" if asked else "; not used here")
        model = attitude_model(load_vehicle(scenario.vehicle).inertia, output if asked else "angles")
        sections.append(Section(title, tuple(structure_conditions(model, needed=asked))))
    return CheckReport(scenario.name, scheme.name, None, tuple(sections), given)


def _trace(run: RecordedRun) -> Trace:
    """The delivered samples of a run."""
    imu, flight = run.bag.series("imu/data"), run.flight
    stamps, first = np.unique(imu.stamp_ns, return_index=True)
    _, here, there = np.intersect1d(stamps, flight.stamp_ns, assume_unique=True, return_indices=True)
    rows = first[here]
    attitude, gyro = imu["orientation_xyzw"][rows].copy(), imu["angular_velocity"][rows].copy()
    attitude[imu["orientation_covariance"][rows][:, 0] == -1.0] = np.nan  # absent, by REP-145
    gyro[imu["angular_velocity_covariance"][rows][:, 0] == -1.0] = np.nan
    return Trace(
        stamp_ns=flight.stamp_ns[there],
        q_xyzw=attitude,
        gyro=gyro,
        torque=flight.torque[there],
        angles=flight.angles[there],
        body_rate=flight.body_rate[there],
        sliding_variable=flight.sliding_variable[there],
        saturated=flight.saturated[there],
    )


def _plain(value: Any) -> Any:
    """Numbers that JSON has; None for what is not finite."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in cast("dict[str, Any]", value).items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in cast("list[Any]", value)]
    if isinstance(value, np.generic):
        value = cast("np.generic[Any]", value).item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
