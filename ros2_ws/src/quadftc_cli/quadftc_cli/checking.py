# pyright: basic
"""What ``quadftc check`` prints: conditions of the theory, pages about vehicles, matrices of isolability."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from quadftc_bags.bag import BagError
from quadftc_cli.screen import console, plain_table, say, warn
from quadftc_flight.loss import loss_story
from quadftc_flight.run_directory import find_run, read_run
from quadftc_flight.scenario import find_scenario, load_scenario, with_components
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_model.vehicle_page import page_rows, plan, warnings
from quadftc_theory.checks import CheckReport, check_run, check_scenario
from quadftc_theory.conditions import Verdict

if TYPE_CHECKING:
    from quadftc_theory.isolability import IsolabilityResult, Mask

COLOURS = {Verdict.PASS: "green", Verdict.FAIL: "red", Verdict.DEPENDS: "yellow"}

# marks of a fault: when a residual responds
LASTING, CHANGING, NEVER, ITSELF = "●", "○", "·", ""
LEGEND = f"{LASTING} also while the fault is constant   {CHANGING} only while it changes   {NEVER} never"


def check_target(
    target: str,
    scheme: str,
    parts: Mapping[str, str],
    changes: tuple[Sequence[str], str],
    sensors: str | None,
    as_json: bool,
) -> bool:
    """Print what is asked for; return whether all that the scheme needs holds.

    ``changes`` are overrides and gains of a scenario. With ``sensors`` it is the isolability.
    """
    overrides, gains = changes
    if target.endswith(".toml") or (target in vehicle_names() and not Path(target).exists()):
        print_vehicle(target, as_json)
        return True
    if sensors is not None:
        _isolability(load_scenario(find_scenario(target), overrides).vehicle, sensors, as_json)
        return True
    path = Path(target)
    if path.is_dir() or (path.is_file() and path.suffix not in (".yaml", ".yml")):
        if any((scheme, *parts.values(), gains, *overrides)):
            wrong = "a recorded run is judged as it was flown; no scheme, parts, --gains, --set"
            raise BagError(f"{path}: {wrong}")
        run = read_run(find_run(path))
        warn(run.warnings)
        report, loss = check_run(run), loss_story(run.flight)
    else:
        scenario = with_components(load_scenario(find_scenario(target), overrides, gains), **parts)
        report, loss = check_scenario(scenario, scenario.scheme(scheme or None)), ""
    if as_json:
        say(json.dumps(report.to_dict(), indent=2, allow_nan=False))
    else:
        _print(report, loss)
    return report.passed


def print_vehicle(name: str, as_json: bool = False) -> None:
    """Print a page about a vehicle; a ValueError says all that is wrong with its file."""
    vehicle = load_vehicle(name)
    rows, warned = page_rows(vehicle), [*warnings(vehicle)]
    if as_json:
        say(json.dumps({"name": vehicle.name, **{row.name: row.value for row in rows}, "warnings": warned}))
        return
    say(f"{vehicle.name}: {vehicle.description}", "")
    say(*plan(vehicle), "", "from above, forward is up; ↺ counter-clockwise, ↻ clockwise")
    table = plain_table(("", "value", ""), ())
    for row in rows:
        table.add_row(*row)
    console().print(table)
    say(*(f"warning: {each}" for each in warned) if warned else ("no warnings",))


def _isolability(vehicle: str, sensors: str, as_json: bool) -> None:
    """Print the matrices: disturbances to be told apart, and disturbances that every residual is blind to."""
    from quadftc_theory.isolability import analyse, isolability_lines
    from quadftc_theory.vehicle_equations import Assumptions

    names = tuple(name.strip() for name in sensors.split(",") if name.strip())
    results = [
        analyse(load_vehicle(vehicle), Assumptions(sensor_set=names, disturbances=role))
        for role in ("faults", "unknown_inputs")
    ]
    if as_json:
        say(json.dumps([result.to_dict() for result in results], indent=2, allow_nan=False))
        return
    for result in results:
        heading, *findings = isolability_lines(result)
        say(heading)
        console().print(isolability_table(result))
        say(*findings, "")
    say(LEGEND)


def isolability_table(result: IsolabilityResult) -> Table:
    """Show for each fault whether it is seen, and told apart from the fault of each column; marks: `LEGEND`.

    Columns carry the numbers of the rows, so that 16 faults fit on a screen of 80 characters.
    """
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=0)
    numbers = [str(number) for number in range(1, len(result.faults) + 1)]
    for heading in ("", "fault", "seen", *numbers):
        side: Any = {"fault": "left", "seen": "center"}.get(heading, "right")
        table.add_column(heading, justify=side, no_wrap=True)
    seen = _marks(result.detectable, result.strongly_detectable)
    apart = _marks(result.isolable, result.strongly_isolable)
    np.fill_diagonal(apart, ITSELF)
    for row in zip(numbers, result.faults, seen, *apart.T, strict=True):
        table.add_row(*row)
    return table


def _marks(at_all: Mask, strongly: Mask) -> NDArray[np.str_]:
    return np.where(at_all, np.where(strongly, LASTING, CHANGING), NEVER)


def _print(report: CheckReport, loss: str) -> None:
    """Print the conditions of a scenario, or of a run; ``loss`` says how that was lost, if it was."""
    screen = console()
    say(f"{report.scenario}, scheme {report.scheme}" + (f", {report.bag}" if report.bag else ""))
    if loss:
        screen.print("[red]LOST[/] ", end="")
        say(loss.removeprefix("lost "))
    for section in report.sections:
        screen.print(f"\n[bold]{section.title}[/]")
        for item in section.conditions:
            colour = COLOURS[item.verdict] if item.needed or item.verdict is not Verdict.FAIL else "yellow"
            screen.print(f"  [{colour}]{item.verdict.value:7}[/] ", end="")
            say(f"{item.name}: {item.text}")
    screen.print(f"\n{'[green]PASS[/]' if report.passed else '[red]FAIL[/]'} ", end="")
    failed = sum(item.verdict is Verdict.FAIL for section in report.sections for item in section.conditions)
    holds = "every condition that the scheme needs holds"
    holds += f"; of the others {failed} {'does' if failed == 1 else 'do'} not" if failed else ""
    say(holds if report.passed else f"fails: {'; '.join(report.failed)}")
