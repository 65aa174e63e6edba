"""The conditions of a whole scheme, in sections, and the verdict."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from pydantic_core import to_json

from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Scenario, Scheme
from quadftc_theory.circumstances import circumstances, circumstances_of_run, trace_of_run
from quadftc_theory.conditions import Circumstances, Condition, judge
from quadftc_theory.linear_model import attitude_model, structure_conditions


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
    def failed(self) -> list[str]:
        """Names of the conditions that fail and that the scheme needs."""
        return [item.name for section in self.sections for item in section.conditions if item.failed]

    @property
    def passed(self) -> bool:
        """Whether nothing fails that the scheme needs."""
        return not self.failed

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON; None for what is not finite."""
        found = {name: getattr(self, name) for name in ("scenario", "scheme", "bag", "passed", "sections")}
        found["bounds"] = self.given.bounds
        return json.loads(to_json(found, inf_nan_mode="null", fallback=lambda scalar: scalar.item()))


def check_scenario(scenario: Scenario, scheme: Scheme, output: str = "imu") -> CheckReport:
    """Judge a scheme in a scenario, without flying it.

    ``output`` is the output of the model (6) that is judged: ``imu``, or ``angles`` as in the paper.
    """
    return _check(scenario, scheme, circumstances(scenario, scheme), output)


def check_run(run: RecordedRun, output: str = "imu") -> CheckReport:
    """Judge the scheme of a recorded run: with the bounds of the recording, and along it."""
    trace = trace_of_run(run)
    given = circumstances_of_run(run, trace)
    report = _check(run.scenario, run.scheme, given, output)
    laws = (run.scheme.observer.law, run.scheme.controller.law)
    found = tuple(item for law in laws for item in judge(law, given, along=trace))
    along = (Section("along the recorded run", found),) if found else ()
    return dataclasses.replace(report, bag=str(run.path), sections=report.sections + along)


def _check(scenario: Scenario, scheme: Scheme, given: Circumstances, output: str) -> CheckReport:
    roles = ("fault observer", "disturbance observer", "controller")
    parts = (scheme.observer, scheme.disturbance_observer, scheme.controller)
    sections = [
        Section(f"{role}: {part.kind}", tuple(judge(part.law, given)))
        for role, part in zip(roles, parts, strict=True)
    ]
    asked = output != "imu"
    if asked or scheme.observer.kind != "none":
        title = "the paper's own set-up, y = (roll, pitch, yaw), q = 3" + ("" if asked else "; not used here")
        model = attitude_model(output if asked else "angles")
        sections.append(Section(title, tuple(structure_conditions(model, needed=asked))))
    return CheckReport(scenario.name, scheme.name, None, tuple(sections), given)
