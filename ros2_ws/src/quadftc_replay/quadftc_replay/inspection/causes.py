"""One cause first: the earliest finding that suffices, and what follows from it.

A rotor that is lost, or a gyro that the controller believes, moves the vehicle as no other test expects, and
estimators go wrong after their sensors. Such findings are told as consequences. Readings that repeat or stop
are facts, whenever they begin; what attitude or velocity do while the estimator says that it resets is none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadftc_replay.flight_log import Event
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import Found
from quadftc_replay.inspection.verdict import Ending, Finding

SUFFICES = 0.7  # probability of a finding that is a cause
SLACK = 0.6  # s; tests over windows see what begins so much earlier
AT_ONCE = 0.1  # s
RECOVERED = 5.0  # s; after a fault that ended, within which estimators find back
FACTS = ("absent", "brownout")  # kinds that no motion makes; readings that are stuck say so themselves
NAVIGATION = ("magnetometer", "barometer", "gps")
# component: what goes wrong after it, besides
FOLLOWS = {
    "response": ("rotor", "gyro", "accelerometer", "attitude", "vibration", *NAVIGATION),
    "rotor": ("rotor", "gyro", "accelerometer", "attitude", *NAVIGATION),
    "gyro": ("rotor", "gyro", "accelerometer", "attitude", *NAVIGATION),
    "accelerometer": ("accelerometer", "attitude", "magnetometer", "gps"),
    "attitude": ("attitude", "magnetometer", "gps"),
    "magnetometer": ("magnetometer", "attitude", "gps"),
    "barometer": ("barometer", "rotor"),  # a vehicle that is flown into the ground rests on it
    "vibration": ("gyro", "accelerometer"),
    "gps": ("gps", "gyro", "accelerometer", "attitude", "barometer"),
}
LATER = {
    "response": -np.inf,  # a vehicle is wired as it is before its log begins
    "gyro": 0.5 * SLACK,
    "accelerometer": 0.5 * SLACK,
    "attitude": SLACK,
}  # s
RESETS = ("reset", "lane switch", "primary", "aligned")  # words of an estimator that starts anew
RESET = 0.5  # s; from its words to the jump
# words of an autopilot that something fails, and of what is no part of the vehicle
FAILS = (
    *("attack", "bad", "crash", "error", "fail", "fd_", "glitch", "inconsistent", "loss", "lost"),
    *("unhealthy", "variance"),
)
OUTSIDE = (
    *("adsb", "autotune", "data link", "fence", "flight mode", "flip", "gcs", "manual control"),
    *("navigation", "pilot", "prearm", "radio", "rc ", "terrain"),
)
# words for a component, by which an autopilot tells of it
WORDS = {"gps": ("GPS",), "gyro": ("Gyro", "gyro"), "accelerometer": ("Accel", "accel")}


def first_cause(
    found: Sequence[Found], ending: Ending, events: Sequence[Event]
) -> tuple[list[Found], list[Found]]:
    """Divide findings into causes, the earliest first, and what follows from them or is explained."""
    left = sorted(_without_doubles(found), key=_rank)
    causes, follows = list[Found](), list[Found]()
    for each in left:
        finding = each.finding
        is_late = ending.kind == "out of control" and finding.onset_s > ending.time_s
        out = is_late and not _is_fact(each)
        is_reset = finding.component == "attitude" and any(
            abs(event.time - finding.onset_s) < RESET and any(word in event.text for word in RESETS)
            for event in events
        )
        follows_one = not (each.is_direct or _is_fact(each)) and any(
            _follows(finding, cause.finding) for cause in causes
        )
        explained = out or is_reset or follows_one
        (follows if explained else causes).append(_as_said(each, events))
    return causes, follows


def reported_failure(flight: Flight) -> Event | None:
    """Return the first failure that the autopilot reports in flight; None: it reports none."""
    for event in flight.log.events:
        text = event.text.lower()
        fails = any(word in text for word in FAILS) and not any(word in text for word in OUTSIDE)
        if fails and flight.intervals[0].start < event.time < flight.intervals[-1].end:
            return event
    return None


def _as_said(found: Found, events: Sequence[Event]) -> Found:
    """Let the autopilot's words, as it begins, choose between what the samples cannot tell apart."""
    finding = found.finding
    for event in events:
        for other in finding.ambiguous_with:
            component, _, element = other.partition("/")
            is_said = any(word in event.text for word in WORDS.get(component, ()))
            if is_said and abs(event.time - finding.onset_s) < RESET:
                said = f"{event.source} at {event.time:.2f} s: {event.text}"
                changed = finding.model_copy(
                    update={
                        "component": component,
                        "element": element or finding.element,
                        "ambiguous_with": (f"{finding.component}/{finding.element}".rstrip("/"),),
                        "evidence": (*finding.evidence, said),
                    }
                )
                return found._replace(finding=changed)
    return found


def _is_fact(found: Found) -> bool:
    """Whether readings repeat or stop."""
    kind = found.finding.kind
    return kind in FACTS or (kind == "stuck" and found.is_direct)


def _rank(found: Found) -> tuple[bool, float]:
    """Order of causes: those that suffice, by onset; at once, those first that others follow from."""
    finding = found.finding
    component = finding.component.split()[0]
    order = LATER.get(component, 0.0)
    if found.is_direct or _is_fact(found):
        # tests by the velocity of satellites see what happens to it within their window
        order = -SLACK if component == "gps" else 0.0
    return finding.probability < SUFFICES, finding.onset_s + order


def _follows(finding: Finding, cause: Finding) -> bool:
    if cause.probability < SUFFICES:
        return False
    if finding.component == cause.component and abs(finding.onset_s - cause.onset_s) < AT_ONCE:
        return False  # several elements of one sensor
    ends = np.inf if cause.end_s is None else cause.end_s + RECOVERED
    within = cause.onset_s - SLACK < finding.onset_s < ends
    return within and finding.component.split()[0] in FOLLOWS.get(cause.component.split()[0], ())


def _without_doubles(found: Sequence[Found]) -> list[Found]:
    """Of findings on one element at one time keep the first: readings tell more than comparisons."""
    kept: list[Found] = []
    for each in sorted(found, key=lambda one: bool(one.finding.ambiguous_with)):
        if not any(_repeats(each.finding, other.finding) for other in kept):
            kept.append(each)
    return kept


def _repeats(finding: Finding, known: Finding) -> bool:
    """Whether a finding says again what another says, of the same element or of a sensor known to be dead."""
    end, ends = (np.inf if each.end_s is None else each.end_s for each in (known, finding))
    if known.onset_s - 1.0 > ends or finding.onset_s > end + 1.0:
        return False
    if f"{known.component}/{known.element}" in finding.ambiguous_with:
        return finding.component != "response"  # which has compared both
    if finding.component != known.component:
        return False
    if known.kind == finding.kind:
        return known.element == finding.element
    is_dead = known.kind in ("stuck", "saturation", "absent", "noise")
    return is_dead and finding.kind in ("offset", "drift", "noise", "unknown", "absent")
