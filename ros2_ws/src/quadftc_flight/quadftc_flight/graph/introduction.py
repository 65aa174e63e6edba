# pyright: basic
"""What a launcher says of a graph: what flies, how to have a say in it, where the bag is."""

from __future__ import annotations

from pathlib import Path

from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.graph.laws import values_of
from quadftc_flight.graph.plan import GraphPlan

PARTS = {  # node -> the parameter that names its law, and its name in words
    "fault_observer": ("observer", "observer"),
    "disturbance_observer": ("observer", "disturbance observer"),
    "controller": ("controller", "controller"),
    "position_controller": ("position_controller", "position controller"),
}


def introduction(plan: GraphPlan) -> list[str]:
    """Say what flies, how to have a say in it, and where the bag is."""
    observer = _value_of(plan, "fault_observer", "observer")
    parts = [
        f"{words} {_value_of(plan, node, name)}"
        for node, (name, words) in PARTS.items()
        if node in plan.executables
    ]
    vehicle = Path(_value_of(plan, "controller", "vehicle")).stem
    kind = "on board" if plan.onboard else plan.plant.replace("_", " ")
    lines = [f"flies: {vehicle}, {kind}; {', '.join(parts)}"]
    if not fault_observers.get(observer).has_detector:
        lines.append(f"note: observer {observer} declares no faults; bank and isolating do (--scheme)")
    where = f" --namespace {plan.namespace.strip('/')}" if plan.namespace else ""
    guidance = "position_controller" if plan.plant == "free_flight" else "reference"
    if _value_of(plan, guidance, "source") == "topic":
        wish = "position x=1 y=0 z=2" if plan.plant == "free_flight" else "attitude roll=5deg"
        lines.append(f"set:    scripts/quadftc set {wish}{where}")
    if not plan.onboard:
        lines.append(f"inject: scripts/quadftc inject bias axis=roll value=3deg duration=10s{where}")
    lines.append(f"watch:  scripts/quadftc watch{where}")
    lines.append(f"bag:    {plan.bag or 'none (--record DIRECTORY)'}; Ctrl-C ends it")
    return lines


def _value_of(plan: GraphPlan, node: str, name: str) -> str:
    """Return a parameter of a node in words."""
    return str(values_of(plan, node)[name])


def farewell(plan: GraphPlan, wall: float) -> str:
    """Say how long it was, and where the bag is."""
    if plan.bag is None or wall == 0.0:
        return f"ended after {wall:.0f} s; nothing was recorded"
    return f"ended after {wall:.0f} s; bag: {plan.bag} (scripts/quadftc report {plan.bag})"
