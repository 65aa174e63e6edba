"""One flight of a firmware: everything started, flown, ended, judged and written.

>>> result = fly_sitl(plan, Path("arducopter"), Path("results/hover"))
>>> result["survived"], result["faults"]
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import cast

import numpy as np
import yaml

from quadftc_control.trajectory import combined
from quadftc_flight.checks import check_results
from quadftc_flight.junit import write_file
from quadftc_flight.summary import Summary
from quadftc_model.samples import DiagnosisReport
from quadftc_model.versions import software_version
from quadftc_replay.inspection.diagnosis import read_with_layout, write_verdict
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.verdict import Finding
from quadftc_ros.reach import open_sockets
from quadftc_sim.autopilot import Shown
from quadftc_sitl.autopilot import Server
from quadftc_sitl.firmware import PARAMETERS, Firmware, parameter_file
from quadftc_sitl.guardian import Guardian
from quadftc_sitl.link import MavlinkLink
from quadftc_sitl.physics import Fate, Physics
from quadftc_sitl.plan import SitlPlan
from quadftc_sitl.recording import Recorder
from quadftc_sitl.scoring import Told, describe_faults, metrics_of, noticed, observed, tells_of

NOTHING: Told = {"named": False, "delay_s": None, "as": []}


SUMMARY, BAG, SCENARIO = "sitl.json", "bag", "scenario.yaml"
LOOK = 2.0  # s of the wall clock; how often the sockets of the firmware are read


def fly_sitl(
    plan: SitlPlan, binary: Path, out: Path, parameters: Mapping[str, float] | None = None, engine: str = "c"
) -> Summary:
    """Fly a plan with a firmware in a new folder; return the summary that is written there.

    ``parameters`` come on top of those of the plan. A `SitlError` says why nothing was flown; OSError, why
    nothing could be written.
    """
    begin = time.perf_counter()
    out.mkdir(parents=True)
    autopilot = plan.autopilot
    given = {**autopilot.parameters(plan), **plan.section.parameters, **(parameters or {})}
    (out / PARAMETERS).write_text(parameter_file(given), encoding="ascii")
    text = yaml.safe_dump(plan.raw, sort_keys=False, width=120)
    (out / SCENARIO).write_text(text, encoding="utf-8")
    place = combined(tuple(part.law for part in plan.scenario.trajectories), 0.0).position
    start = float(place[0]), float(place[1])
    physics = Physics(plan, start, engine)
    channels = {fault.injection.channel for fault in plan.scenario.faults}
    # what is entered last ends first: the firmware before those that it talks to
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(MavlinkLink()))
        server = stack.enter_context(contextlib.closing(autopilot.server()))
        beginning = autopilot.start(binary, out, server.port, link.port)
        stack.callback(autopilot.tidy, beginning)
        attachments = {SCENARIO: text.encode()}
        recorder = stack.enter_context(contextlib.closing(Recorder(out / BAG, attachments, channels)))
        flight = Flight(plan, physics, server, link, recorder)
        firmware = stack.enter_context(Firmware(beginning.arguments, out, beginning.environment))
        flight.fly(firmware)
        firmware.end(flight.serve)
    # judged by what it logged itself, and by our truth
    wall_time = time.perf_counter() - begin
    result = flight.result(beginning.arguments, wall_time)
    result |= diagnose_log_of(out, plan, flight.log_zero, result["faults"])
    result["metrics"] = metrics_of(result, flight.errors)
    result["checks"] = [each._asdict() for each in check_results(result["metrics"], plan.section.checks)]
    write_file(out / SUMMARY, json.dumps(_finite(result), indent=2, allow_nan=False) + "\n")
    return result


class Flight:
    """What happens between the packets of a firmware."""

    def __init__(
        self, plan: SitlPlan, physics: Physics, server: Server, link: MavlinkLink, recorder: Recorder
    ) -> None:
        self._plan, self._physics, self._server = plan, physics, server
        self._recorder, self._link = recorder, link
        self.pilot = plan.autopilot.pilot(plan, link, physics.begin)
        self._fate = Fate(physics.stand)
        self._guardian = Guardian(plan.section.guard)
        self._heard = 0  # reports of the observer
        self._sockets: list[str] = []
        self.errors: list[float] = []  # distance from the reference at each sample of the mission [m]

    @property
    def log_zero(self) -> float:
        """Scenario time 0 on the clock of the firmware [s]."""
        return (self.pilot.began or 0.0) + self.pilot.journal.boot_offset

    def fly(self, firmware: Firmware) -> None:
        """Fly to the end; a `SitlError` says why that cannot be done."""
        look = time.monotonic()
        while not self.pilot.done:
            self._answer(self._server.wait(firmware, self._link.spoke))
            if time.monotonic() > look:
                look = time.monotonic() + LOOK
                self._sockets = sorted({*self._sockets, *open_sockets(firmware.pid)})

    def serve(self, patience: float) -> None:
        """Answer what comes in so long [s], while the firmware ends."""
        end = time.monotonic() + patience
        while (left := end - time.monotonic()) > 0.0:
            self._answer(self._server.take(left))

    def _answer(self, packets: list[bytes]) -> None:
        line = None
        for data in packets:
            answer, shown = self._physics.answer(data, self._recorder)
            line = answer or line
            if shown is not None:
                self._watch(shown)
        if line is not None:
            self._server.send(line)
            self._physics.sent()

    def _watch(self, shown: Shown) -> None:
        """Let the pilot act on a sample, and see whether the vehicle is lost."""
        pilot, now, motion = self.pilot, self._physics.now, shown.emission.flight
        assert motion is not None  # it flies
        pilot.step(now)
        if pilot.began is None or pilot.done or pilot.landed:
            return
        self._guard()
        wanted = pilot.reference(now)
        if now <= pilot.end:
            self.errors.append(math.dist(motion.position, wanted.position))
        if self._fate.step(motion, wanted) and pilot.lost is None:
            pilot.lost = now

    def _guard(self) -> None:
        """Let the guardian hear what the observer has said of a vehicle that flies."""
        reports, pilot = self._physics.reports, self.pilot
        for report in reports[self._heard :] if pilot.flies and pilot.journal.flies else ():
            before = len(self._guardian.decisions)
            decision = self._guardian.step(report, pilot.journal.mode_name)
            for each in self._guardian.decisions[before:]:
                self._recorder.tell(report.stamp_ns, "guardian", each.words)
            if decision is not None:
                pilot.obey(decision)
        self._heard = len(reports)

    def result(self, arguments: list[str], wall_time: float) -> Summary:
        """Return what is known without the firmware's log."""
        plan, pilot, physics = self._plan, self.pilot, self._physics
        zero, journal = pilot.began or 0.0, pilot.journal
        scenario = plan.scenario
        flown = -math.inf if pilot.began is None else physics.now - zero  # s of the scenario
        faults = describe_faults(plan, [each for each in scenario.faults if each.injection.start <= flown])
        events = [event._replace(time=round(event.time - zero, 3)) for event in journal.events]
        survived = pilot.lost is None and (pilot.landed or self._fate.stands)
        stands = "stands with its motors running" if self._fate.stands else "still flying when time was up"
        ended = self._fate.words or ("landed" if pilot.landed else stands)
        for fault in faults:
            fault["autopilot"] = noticed(fault, events)
            fault["observer"] = observed(fault, physics.reports, physics.begin_ns or 0)
        return {
            "name": plan.name,
            "scenario": scenario.name,
            "scheme": plan.scheme.name,
            "observer": plan.scheme.observer.kind,
            "seed": scenario.seed,
            "vehicle": scenario.vehicle,
            "autopilot": {
                "kind": plan.autopilot.name,
                "name": plan.autopilot.title,
                "version": journal.version,
                "command": arguments,
                "open_sockets": self._sockets,
                "wrong_packets": physics.wrong_packets(),
                "packets_from_elsewhere": self._server.strangers + self._link.strangers,
            },
            "survived": survived,
            "ended": ended,
            "lost_s": None if pilot.lost is None else round(pilot.lost - zero, 3),
            "faults": faults,
            "observer_said": observed_all(physics.reports, physics.begin_ns or 0, pilot.end - zero),
            "guardian": self._guarded(),
            "autopilot_said": [event._asdict() for event in events],
            "real_time_factor": physics.now / wall_time if wall_time > 0.0 else None,
            "recorded": {"messages": sum(self._recorder.counts.values()), "problem": self._recorder.problem},
            "versions": {"quadftc": software_version(), "pymavlink": version("pymavlink")},
        }

    def _guarded(self) -> Told:
        """Return what the guardian was to do, and what it decided, in the time of the scenario."""
        begin = 1e-9 * (self._physics.begin_ns or 0)
        decided = [dataclasses.asdict(each) for each in self._guardian.decisions]
        decided = [{**each, "time": round(each["time"] - begin, 3)} for each in decided]
        return {**self._plan.section.guard.model_dump(), "decisions": decided}


def observed_all(reports: Iterable[DiagnosisReport], begin_ns: int, duration: float) -> list[Told]:
    """Return each fault that the observer has confirmed in the mission, once, with its time [s]."""
    seen: dict[tuple[str, str], Told] = {}
    for report in reports:
        at = round(1e-9 * (report.stamp_ns - begin_ns), 3)
        if begin_ns and 0.0 <= at < duration:
            for fault in report.faults:
                key = fault.component, fault.element
                first = {"component": key[0], "element": key[1], "kind": fault.kind, "time": at}
                seen.setdefault(key, {**first, "ambiguous_with": list(fault.ambiguous_with)})
    return list(seen.values())


def _finite(value: object) -> object:
    """Return data as JSON takes it: what is not finite becomes None, NumPy's numbers plain ones."""
    if isinstance(value, dict):
        return {str(key): _finite(each) for key, each in cast("dict[object, object]", value).items()}
    if isinstance(value, (list, tuple)):
        return [_finite(each) for each in cast("list[object]", value)]
    plain = cast("object", value.item()) if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain


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
    own = [each for each in findings if tells_of(fault, each, "onset")]
    own.sort(key=lambda each: each["onset"])
    if not own:
        return dict(NOTHING)
    words = [f"{each['component']} {each['element']}: {each['kind']}".replace(" :", ":") for each in own]
    return {"named": True, "delay_s": round(own[0]["onset"] - fault["start"], 3), "as": words}
