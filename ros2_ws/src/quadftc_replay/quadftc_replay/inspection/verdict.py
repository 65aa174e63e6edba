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

VERSION = 1  # of the schema; a key that changes its meaning raises it
SENTENCE_FINDINGS = 3  # findings that the sentence names

Kind = Literal["offset", "stuck", "saturation", "noise", "absent", "loss", "off", "brownout", "unknown"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="null")


class Finding(_Strict):
    """A fault of one element of one component."""

    component: str = Field(description="gyro, accelerometer, attitude, rotor, battery; another IMU: 'gyro 2'")
    element: str = Field(description="x, y, z; roll, pitch, yaw; a rotor's number from 1; '': all of it")
    kind: Kind = Field(description="what the fault looks like; loss: a part is missing, off: all of it")
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
        return f"{self.component} {self.element}".strip()


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


class Verdict(_Strict):
    """What is said of a log."""

    version: Literal[1]
    log: str = Field(description="file name")
    format: str
    duration_s: float = Field(ge=0.0)
    flight_s: float = Field(ge=0.0, description="time in flight; the whole log where phases are not known")
    baseline: str | None = Field(description="file name of the healthy log; null: none was given")
    healthy: bool = Field(description="whether there is no finding")
    sentence: str
    findings: tuple[Finding, ...] = Field(description="most probable first")
    not_judged: tuple[NotJudged, ...]
    judged: tuple[str, ...] = Field(description="components that were tested")
    model: Model | None = Field(description="null: none could be identified")
    notes: tuple[str, ...] = Field(description="of the reader and the tests, one line each")


def summarise(findings: Sequence[Finding], judged: Sequence[str], not_judged: Sequence[NotJudged]) -> str:
    """Say the verdict in one sentence."""
    if not judged:
        reasons = "; ".join(dict.fromkeys(each.reason for each in not_judged)) or "no sensor was logged"
        return f"Nothing can be said: {reasons}."
    if not findings:
        missing = unjudged(judged, not_judged)
        rest = f"; {join(missing)} could not be judged" if missing else ""
        partial = {each.component for each in not_judged}
        found = [f"{each} (in part)" if each in partial else each for each in judged]
        return f"No fault found in {join(found)}{rest}."
    parts = [_describe(each) for each in findings[:SENTENCE_FINDINGS]]
    if more := len(findings) - SENTENCE_FINDINGS:
        parts += [f"{more} more finding{'s' if more > 1 else ''}"] if more > 0 else []
    text = join(parts)
    return f"{text[0].upper()}{text[1:]}."


def unjudged(judged: Sequence[str], not_judged: Sequence[NotJudged]) -> list[str]:
    """Return the components of which nothing was judged."""
    return [each for each in dict.fromkeys(entry.component for entry in not_judged) if each not in judged]


def _describe(finding: Finding) -> str:
    size = f" of {show(finding.size, finding.unit)}" if finding.size is not None else ""
    what = {
        "offset": f"{finding.name} has an offset{size}",
        "stuck": f"{finding.name} is stuck",
        "saturation": f"{finding.name} is saturated",
        "noise": f"{finding.name} is noisy",
        "absent": f"{finding.name} gives no usable reading",
        "loss": f"{finding.name} lost {_share(finding.size)} of its thrust",
        "off": f"{finding.name} gives no thrust",
        "brownout": f"{finding.name} breaks down",
        "unknown": f"{finding.name} is at fault",
    }[finding.kind]
    until = "" if finding.end_s is None else f" to {finding.end_s:.2f} s"
    doubt = (
        f" (or {join([each.replace('/', ' ') for each in finding.ambiguous_with], 'or')})"
        if finding.ambiguous_with
        else ""
    )
    return f"{what} from {finding.onset_s:.2f} s{until}{doubt}"


def _share(size: float | None) -> str:
    return "part" if size is None else f"{100.0 * size:.0f} %"


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
