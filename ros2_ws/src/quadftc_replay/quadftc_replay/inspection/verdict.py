"""What `quadftc diagnose` says of a log, as ``verdict.json`` holds it.

    python -m quadftc_replay.inspection.verdict docs/verdict.schema.json

writes the JSON schema.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

VERSION = 2  # of the schema; a key that changes its meaning raises it

Outcome = Literal["fault", "healthy", "not enough to say"]
Kind = Literal[
    "offset",
    "drift",
    "interference",
    "stuck",
    "saturation",
    "noise",
    "absent",
    "loss",
    "off",
    "brownout",
    "rise",
    "reversed",
    "exchanged",
    "unknown",
]
EndKind = Literal["in flight", "landed", "switched off in the air", "hit the ground", "out of control"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="null")


class Finding(_Strict):
    """A fault of one element of one component."""

    component: str = Field(
        description="gyro, accelerometer, attitude, rotor, battery, speed sensor, magnetometer, barometer,"
        " gps, vibration, position (as it is flown by), response (of the vehicle to its commands);"
        " another one: 'gyro 2'"
    )
    element: str = Field(
        description="x, y, z (gps, position: east, north, up); roll, pitch, yaw, or several of them;"
        " a rotor's number; '': all of it"
    )
    kind: Kind = Field(
        description="what the fault looks like; loss: a part is missing, off: all of it;"
        " reversed: it answers the wrong way, exchanged: another axis does"
    )
    onset_s: float = Field(ge=0.0, description="begin, in seconds from the first sample of the log")
    end_s: float | None = Field(description="end in the same seconds; null: it lasts to the end of the log")
    size: float | None = Field(description="reading less truth, or share of thrust lost; null: none")
    sigma: float | None = Field(ge=0.0, description="standard deviation of the size; null: not known")
    unit: str = Field(description="of size and sigma; '1' for shares, '' without a size")
    probability: float = Field(ge=0.0, le=1.0, description="that this component is at fault")
    ambiguous_with: tuple[str, ...] = Field(
        description="what the samples might mean as well: component/element, or a word"
    )
    evidence: tuple[str, ...] = Field(description="one sentence each: what was measured, against what")

    @property
    def name(self) -> str:
        """The component with its element."""
        if self.component == "rotor" and not self.element:
            return "all rotors"
        return f"{self.component} {self.element}".strip().replace("gps", "GPS")

    def may_be(self, component: str) -> bool:
        """Whether another component may be at fault instead."""
        return any(each.partition("/")[0] == component for each in self.ambiguous_with)


class NotJudged(_Strict):
    """A component about which nothing can be said."""

    component: str
    reason: str


class Model(_Strict):
    """The model of angular acceleration that was identified from the log."""

    source: Literal["rotor_speeds", "rotor_commands", "torque_command"]
    lag_s: float = Field(description="time constant of the rotors")
    r2: tuple[float, float, float] = Field(description="share of variance explained where it was not fitted")
    usable: tuple[bool, bool, bool] = Field(description="whether the log excites the axis enough")


class Ending(_Strict):
    """How the flight ended."""

    kind: EndKind
    time_s: float = Field(description="when it began to end so; in flight: the end of the log")
    impact_s: float | None = Field(description="when it hit the ground; null: it did not, or gently")
    sentence: str


class Moment(_Strict):
    """Something that happened, and who says so."""

    time_s: float
    source: str = Field(description="diagnose; log: a signal beyond its limit; MSG, ERR, EV, a topic of PX4")
    text: str


class Level(_Strict):
    """A level of false alarms that was asked for, and what supports it."""

    asked: str
    threshold: float = Field(description="findings count above this probability")
    rate_per_h: float = Field(description="flights with a false finding an hour, at most, of healthy ones")
    flights: int = Field(description="healthy flights that it was calibrated on")
    hours: float = Field(description="how long they last together")


class Verdict(_Strict):
    """What is said of a log."""

    version: Literal[2]
    log: str = Field(description="file name")
    format: str
    duration_s: float = Field(ge=0.0)
    flight_s: float = Field(ge=0.0, description="time in flight; the whole log where phases are not known")
    baseline: str | None = Field(description="file name of the healthy log; null: none was given")
    outcome: Outcome = Field(
        description="healthy: no finding, and all that can bring a vehicle down was judged; exit code 1, 0, 4"
    )
    healthy: bool = Field(description="whether the outcome is healthy")
    sentence: str
    level: Level | None = Field(description="of false alarms; null: none was asked for")
    findings: tuple[Finding, ...] = Field(description="the earliest cause first; doubtful ones last")
    ending: Ending
    timeline: tuple[Moment, ...] = Field(
        description="findings, those below the level that was asked for, what followed from them, how it"
        " ended, and what the autopilot said, in order"
    )
    not_judged: tuple[NotJudged, ...]
    judged: tuple[str, ...] = Field(
        description="components that were tested; sound, unless a finding has them, or is ambiguous with them"
    )
    model: Model | None = Field(description="null: none could be identified")
    advice: tuple[str, ...] = Field(description="what to log in the next flight, in the autopilot's words")
    notes: tuple[str, ...] = Field(description="of the reader and the tests, one line each")


def unjudged(judged: Sequence[str], not_judged: Sequence[NotJudged]) -> list[str]:
    """Return the components of which nothing was judged."""
    return [each for each in dict.fromkeys(entry.component for entry in not_judged) if each not in judged]


def doubted(verdict: Verdict, component: str) -> str:
    """Say which finding of others a component may be the cause of instead; '': it has its own, or none."""
    others = [each.name for each in verdict.findings if each.may_be(component)]
    own = any(each.component == component for each in verdict.findings)
    return "" if own or not others else f"may be at fault instead of {join(others)}"


def unsaid(verdict: Verdict) -> list[NotJudged]:
    """Return what could not be judged for a reason that the sentence of the verdict does not give."""
    return [each for each in verdict.not_judged if f"({each.reason})" not in verdict.sentence]


def show(value: float, unit: str) -> str:
    """Write a size with its unit."""
    return f"{100.0 * value:.0f} %" if unit == "1" else f"{value:.3g} {unit.replace('^2', '²')}"


def join(words: Sequence[str], last: str = "and") -> str:
    """Join words as in a sentence."""
    return f" {last} ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def schema() -> str:
    """Return the JSON schema of ``verdict.json``."""
    content = Verdict.model_json_schema(mode="serialization")
    return json.dumps({"$schema": "https://json-schema.org/draft/2020-12/schema", **content}, indent=2) + "\n"


def main() -> None:
    """Write the schema into a file."""
    parser = argparse.ArgumentParser(description="Write the JSON schema of verdict.json.")
    parser.add_argument("file", type=Path)
    parser.parse_args().file.write_text(schema(), encoding="utf-8")


if __name__ == "__main__":
    main()
