"""What `quadftc diagnose` says of the log that the firmware has left."""

from __future__ import annotations

from pathlib import Path

from quadftc_replay.inspection.diagnosis import read_with_layout, write_verdict
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.verdict import Finding
from quadftc_sitl.plan import SitlPlan
from quadftc_sitl.scoring import EARLY, Told, is_it

NOTHING: Told = {"named": False, "delay_s": None, "as": []}


def diagnose_log_of(folder: Path, plan: SitlPlan, log_zero: float, faults: list[Told]) -> dict[str, Told]:
    """Judge the log; put what was said of each fault into it, and return all that was said.

    ``log_zero`` is scenario time 0 on the clock of the log [s].
    """
    log = plan.autopilot.log(folder)
    said: Told = {"log": "", "outcome": "", "findings": [], "problem": ""}
    for fault in faults:
        fault["diagnose"] = dict(NOTHING)
    if log is None:
        return {"diagnose": {**said, "problem": "the firmware has left no log"}}
    said["log"] = str(log.relative_to(folder))
    try:
        recording = read_with_layout(log, "")
        verdict = inspect(recording, None).verdict
    except ValueError as error:
        return {"diagnose": {**said, "problem": str(error)}}
    write_verdict(verdict, folder)
    shift = 1e-9 * recording.start_ns - log_zero
    findings = [_finding(each, shift) for each in verdict.findings]
    for fault in faults:
        fault["diagnose"] = _of_fault(fault, findings)
    said |= {"outcome": verdict.outcome, "sentence": verdict.sentence, "findings": findings}
    return {"diagnose": said}


def _finding(finding: Finding, shift: float) -> Told:
    given = finding.model_dump(mode="json", include={"component", "element", "kind", "size", "unit"})
    end = None if finding.end_s is None else round(finding.end_s + shift, 3)
    return {
        **given,
        "probability": finding.probability,
        "ambiguous_with": list(finding.ambiguous_with),
        "onset": round(finding.onset_s + shift, 3),
        "end": end,
    }


def _of_fault(fault: Told, findings: list[Told]) -> Told:
    """Return the findings that are a fault, the earliest first."""
    own = [
        each
        for each in sorted(findings, key=lambda each: each["onset"])
        if is_it(fault, each["component"], each["element"], each["ambiguous_with"])
        and each["onset"] >= fault["start"] - EARLY
    ]
    if not own:
        return dict(NOTHING)
    words = [f"{each['component']} {each['element']}: {each['kind']}".replace(" :", ":") for each in own]
    return {"named": True, "delay_s": round(own[0]["onset"] - fault["start"], 3), "as": words}
