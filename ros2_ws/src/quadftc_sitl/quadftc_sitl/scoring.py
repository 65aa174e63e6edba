"""Each fault of a flight beside what was said of it: by the autopilot, by our observer, by `diagnose`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from quadftc_fdi.diagnosis import BODY_AXES
from quadftc_flight.scenario import Fault
from quadftc_flight.summary import Summary
from quadftc_model.samples import AXES, DiagnosisReport
from quadftc_model.spec import parse_spec
from quadftc_sim.rotor_fault import ROTOR
from quadftc_sitl.journal import Event
from quadftc_sitl.plan import SitlPlan

Told = dict[str, Any]  # part of sitl.json: of a fault, or of what was said of it

AFTERWARDS = 5.0  # s; what is said up to then after a fault has ended counts as said of it
EARLY = 1.0  # s; an onset that is found this much before the fault is still its own
SHOWN = 20  # events of the autopilot in the summary of a fault
SIZES = ("value", "rate", "sigma")  # of our faults, what says how large they are; SI
# axes of the attitude, as those of the other sensors
BODY: dict[str, str] = dict(zip(AXES, BODY_AXES, strict=True))


def describe_faults(plan: SitlPlan, ours: Iterable[Fault] | None = None) -> list[Told]:
    """Return the truth: what fails in a flight, where and when [s]; ``ours`` in place of the scenario's."""
    faults: list[Told] = []
    for fault in plan.scenario.faults if ours is None else ours:
        injection, channel = fault.injection, fault.injection.channel
        elements = list(injection.elements)
        if channel not in ("attitude", ROTOR):
            elements = [BODY[axis] for axis in elements]
        truth = {"source": "sensor" if channel != ROTOR else "rotor", "component": channel}
        values = parse_spec(fault.spec).values
        size = next((float(value) for key in SIZES if isinstance(value := values.get(key), str)), None)
        faults.append(
            {**truth, "elements": elements, "kind": injection.kind, "spec": fault.spec, "size": size}
            | {"start": injection.start, "stop": injection.stop}
        )
    for own in plan.section.faults:
        component, _, element = own.failing.partition(" ")
        elements = [element] if element else _elements_of(component, own.set)
        spec = own.inject or " ".join(f"{name}={value:g}" for name, value in own.set.items())
        faults.append(
            {"source": "autopilot", "component": component, "elements": elements, "spec": spec}
            | {"size": max(own.set.values(), key=abs, default=None)}
            | {"kind": own.kind or own.inject.rpartition(" ")[2], "start": own.start, "stop": own.end}
        )
    return faults


def _elements_of(component: str, values: Mapping[str, float]) -> list[str]:
    """Return which elements some parameters of the autopilot's simulation make fail; none: all of it."""
    if component == ROTOR:
        mask = int(values.get("SIM_ENGINE_FAIL", 0.0))
        return [str(number + 1) for number in range(32) if mask >> number & 1]
    return [name[-1].lower() for name in values if name[-2:] in ("_X", "_Y", "_Z")]


def noticed(fault: Told, events: Sequence[Event]) -> Told:
    """Return what the autopilot said from a fault on: the first that was serious, and all of it."""
    during = [event for event in events if fault["start"] <= event.time < fault["stop"] + AFTERWARDS]
    first = next((event for event in during if event.serious), None)
    return {
        "noticed": first is not None,
        "delay_s": None if first is None else round(first.time - fault["start"], 3),
        "words": "" if first is None else first.words,
        "lane_delay_s": next(
            (round(event.time - fault["start"], 3) for event in during if event.kind == "lane"), None
        ),
        "said": [f"{event.time - fault['start']:.2f} s: {event.words}" for event in during[:SHOWN]],
    }


def observed(fault: Told, reports: Iterable[DiagnosisReport], begin_ns: int) -> Told:
    """Return what our fault observer said of a fault; ``named`` is None for what it is not told of."""
    if fault["source"] == "autopilot":
        return {"named": None, "delay_s": None, "as": [], "others": []}
    named: Told = {"named": False, "delay_s": None, "as": [], "others": []}
    for report in reports:
        elapsed = 1e-9 * (report.stamp_ns - begin_ns) - fault["start"]
        if not 0.0 <= elapsed < fault["stop"] - fault["start"] + AFTERWARDS:
            continue
        for each in report.faults:
            name = f"{each.component} {each.element}"
            if is_it(fault, each.component, each.element, each.ambiguous_with):
                if not named["named"]:
                    named |= {"named": True, "delay_s": round(elapsed, 3)}
                named["as"] = list(dict.fromkeys([*named["as"], f"{name}: {each.kind}"]))
            else:
                named["others"] = list(dict.fromkeys([*named["others"], name]))
    return named


def is_it(fault: Told, component: str, element: str, rivals: Sequence[str] = ()) -> bool:
    """Return whether a finding is this fault: by component and element, or by what it might be as well."""
    names = [(kind_of(component), element)]
    names += [tuple(rival.partition("/")[::2]) for rival in rivals if "/" in rival]
    elements = {str(each) for each in fault["elements"]}
    return any(
        (name == fault["component"] or (fault["component"] == "imu" and name in ("gyro", "accelerometer")))
        and (not elements or not one or one in elements or BODY.get(one, one) in elements)
        for name, one in names
    )


def tells_of(fault: Told, said: Told, key: str) -> bool:
    """Return whether what was said is this fault, and at its ``key`` [s] not too early."""
    is_same = is_it(fault, said["component"], said["element"], said["ambiguous_with"])
    return is_same and said[key] >= fault["start"] - EARLY


def kind_of(component: str) -> str:
    """Return a component without its number: ``gyro`` for ``gyro 2``."""
    return component.rstrip("0123456789 ")


def metrics_of(result: Summary, errors: Sequence[float]) -> dict[str, float | None]:
    """Return the numbers of a flight that a scenario can check, by name; None: there is none."""
    faults = result["faults"]

    def worst(source: str) -> float | None:
        delays = [fault[source]["delay_s"] for fault in faults]
        return None if not delays or None in delays else max(delays)

    squares = np.square(np.array(errors, np.float64))
    return {
        "survived": float(result["survived"]),
        "position_rmse_m": math.sqrt(float(squares.mean())) if len(squares) else None,
        "position_max_m": float(math.sqrt(squares.max())) if len(squares) else None,
        "autopilot_delay_s": worst("autopilot"),
        "observer_delay_s": worst("observer"),
        "diagnose_delay_s": worst("diagnose"),
        "autopilot_noticed": sum(fault["autopilot"]["noticed"] for fault in faults),
        "observer_named": sum(bool(fault["observer"]["named"]) for fault in faults),
        "diagnose_named": sum(bool(fault["diagnose"]["named"]) for fault in faults),
        "observer_false": len(_false(faults, result["observer_said"], "time")),
        "diagnose_false": len(_false(faults, result["diagnose"]["findings"], "onset")),
        "guardian_actions": sum(not each["refused"] for each in result["guardian"]["decisions"]),
        "autopilot_false": sum(
            event["serious"]
            and event["time"] >= 0.0
            and not any(fault["start"] <= event["time"] for fault in faults)
            for event in result["autopilot_said"]
        ),
    }


def _false(faults: Sequence[Told], said: Sequence[Told], key: str) -> list[Told]:
    """Return what was said of components that are healthy, or too early."""
    return [each for each in said if not any(tells_of(fault, each, key) for fault in faults)]
