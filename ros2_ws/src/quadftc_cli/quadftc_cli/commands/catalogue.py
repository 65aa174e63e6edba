"""``quadftc list``: observers, controllers, faults, winds... with their parameters, from the registries."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from typing import Annotated, Any, cast

from rich.console import Group
from rich.table import Table
from typer import Argument

from quadftc_cli.screen import console, plain_table
from quadftc_control.controller import controllers
from quadftc_control.position_controller import position_controllers
from quadftc_control.reference import references
from quadftc_control.trajectory import trajectories
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.scenario import ScenarioError, find_scenario, load_scenario, scenario_names
from quadftc_model.parameters import Parameter, parameters_of
from quadftc_model.registry import Registry
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_sim.barometer import BAROMETER_GRADES, Barometer
from quadftc_sim.disturbance import disturbances
from quadftc_sim.fault import faults
from quadftc_sim.magnetometer import MAGNETOMETER_GRADES, Magnetometer
from quadftc_sim.position_sensor import POSITION_GRADES, PositionSensor
from quadftc_sim.rotor_fault import rotor_faults
from quadftc_sim.sensors import GRADES, ImuSensor
from quadftc_sim.wind import winds

REGISTRIES: dict[str, Registry[Any]] = {
    "observers": fault_observers,
    "disturbance_observers": disturbance_observers,
    "controllers": controllers,
    "position_controllers": position_controllers,
    "references": references,
    "trajectories": trajectories,
    "faults": faults,
    "rotor_faults": rotor_faults,
    "disturbances": disturbances,
    "winds": winds,
}
SENSORS: dict[str, tuple[type, Mapping[str, Mapping[str, object]]]] = {
    "sensors": (ImuSensor, GRADES),
    "position_sensor": (PositionSensor, POSITION_GRADES),
    "magnetometer": (Magnetometer, MAGNETOMETER_GRADES),
    "barometer": (Barometer, BAROMETER_GRADES),
}
KINDS = (*REGISTRIES, "sensors", "vehicles", "scenarios")


def list_(kind: Annotated[str, Argument(help=" | ".join(KINDS) + "; default: names of all")] = "") -> None:
    """Show what there is, by name; of one kind with parameters, units and defaults."""
    if kind and kind not in KINDS:
        raise ValueError(f"list: no '{kind}'; there are: {', '.join(KINDS)}")
    tables = {"sensors": _sensors, "vehicles": _vehicles, "scenarios": _scenarios}
    if not kind:
        console().print(_names())
        return
    console().print(tables[kind]() if kind in tables else _components(kind))


def _names() -> Table:
    """Tabulate the names of every kind."""
    table = plain_table(("quadftc list", "names"), ())
    table.columns[1].no_wrap = False
    named = {kind: registry.names() for kind, registry in REGISTRIES.items()}
    named |= {"sensors": tuple(SENSORS), "vehicles": vehicle_names(), "scenarios": scenario_names()}
    for kind in KINDS:
        table.add_row(kind, ", ".join(named[kind]))
    return table


def _components(kind: str) -> Table:
    registry = REGISTRIES[kind]
    table = _table(kind, "name", "what it is", "parameter", "default", "unit", "meaning")
    for name in registry.names():
        component = registry.get(name)
        rows = parameters_of(component)
        summary = (inspect.getdoc(component) or "").partition("\n\n")[0].replace("`", "")
        table.add_row(f"[bold]{name}[/]", summary, *(_cells(rows[0]) if rows else ("",) * 4))
        for row in rows[1:]:
            table.add_row("", "", *_cells(row))
        table.add_section()
    if kind in ("faults", "rotor_faults"):
        place = "channel, axes" if kind == "faults" else "rotors"
        table.caption = f"Each has {place}, start, and stop or duration, too."
    return table


def _cells(row: Parameter) -> tuple[str, str, str, str]:
    default = row.default
    values = default if isinstance(default, tuple) else (default,)
    words = [f"{value:g}" if type(value) is float else str(value) for value in values]
    text = words[0] if len(set(words)) == 1 else ", ".join(words)
    unit = {"1": "", "{channel}": "as channel", "{channel_rate}": "channel/s"}.get(row.unit, row.unit)
    choices = f" ({', '.join(row.choices)})" if row.choices else ""
    return row.name, text, unit, row.doc + choices


def _sensors() -> Group:
    """Tabulate the grades of each sensor, angles in degrees."""
    return Group(*(_grades(title, law, grades) for title, (law, grades) in SENSORS.items()))


def _grades(title: str, law: type, grades: Mapping[str, Mapping[str, object]]) -> Table:
    table = _table(title, "parameter", *grades, "unit", "meaning")
    for row in parameters_of(law):
        unit = row.unit.replace("rad", "deg")
        factor = math.degrees(1.0) if unit != row.unit else 1.0
        values = [_value(grade.get(row.name, row.default), factor) for grade in grades.values()]
        table.add_row(f"[bold]{row.name}[/]", *values, "" if unit == "1" else unit, row.doc)
    return table


def _value(value: object, factor: float) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    parts = cast("tuple[float, ...]", value if isinstance(value, tuple) else (value,))
    words = [f"{factor * part:.4g}" for part in parts]
    return words[0] if len(set(words)) == 1 else ", ".join(words)


def _vehicles() -> Table:
    headings = ("mass [kg]", "inertia [kg m²]", "authority [N m]", "rotors", "thrust/weight", "hover [rad/s]")
    table = _table("vehicles", "name", "what it is", *headings)
    for name in vehicle_names():
        vehicle = load_vehicle(name)
        listed = (", ".join(f"{x:.3g}" for x in values) for values in (vehicle.inertia, vehicle.authority))
        rotors, hover = str(len(vehicle.rotors.positions)), f"{vehicle.hover_speed:.0f}"
        flight = (f"{vehicle.mass:g}", *listed, rotors, f"{vehicle.thrust_to_weight:.2f}", hover)
        table.add_row(f"[bold]{name}[/]", vehicle.description, *flight)
    return table


def _scenarios() -> Table:
    table = _table("scenarios", "name", "duration", "rate", "vehicle", "schemes", "what it is")
    for name in scenario_names():
        try:
            found = load_scenario(find_scenario(name))
        except ScenarioError as error:
            table.add_row(f"[bold]{name}[/]", "", "", "", "", f"[red]{str(error).partition(chr(10))[0]}[/]")
            continue
        extent = (f"{found.duration:g} s", f"{found.rate:g} Hz", found.vehicle, ", ".join(found.schemes))
        table.add_row(f"[bold]{name}[/]", *extent, " ".join(found.description.split()))
    return table


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title.replace("_", " "), title_justify="left")
    for heading in headings:
        table.add_column(heading, vertical="top")
    return table
