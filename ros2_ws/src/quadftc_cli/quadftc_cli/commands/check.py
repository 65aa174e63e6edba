# pyright: basic
"""``quadftc check``."""

from __future__ import annotations

import enum
import json
from pathlib import Path
from typing import Annotated

import typer

from quadftc_bags.bag import BagError
from quadftc_cli.commands import CHECK_FAILED, GOOD
from quadftc_cli.commands.options import GainsOption
from quadftc_cli.tables import console
from quadftc_flight.run_directory import read_run
from quadftc_flight.scenario import (
    Scenario,
    find_scenario,
    load_scenario,
    with_controller,
    with_disturbance_observer,
    with_observer,
)
from quadftc_model.vehicle import load_vehicle
from quadftc_theory.checks import CheckReport, check_run, check_scenario
from quadftc_theory.conditions import Verdict

COLOURS = {Verdict.PASS: "green", Verdict.FAIL: "red", Verdict.DEPENDS: "yellow"}


class Output(str, enum.Enum):
    """What the model's output y is."""

    imu = "imu"
    angles = "angles"


def check(
    target: Annotated[
        str, typer.Argument(metavar="SCENARIO|BAG", help="Scenario file or name, or a recorded run.")
    ],
    scheme: Annotated[str, typer.Option(help="Scheme to judge; default: the scenario's first.")] = "",
    observer: Annotated[str, typer.Option(help="Fault observer in place of the scheme's.")] = "",
    disturbance_observer: Annotated[
        str, typer.Option(help="Disturbance observer in place of the scheme's.")
    ] = "",
    controller: Annotated[str, typer.Option(help="Controller in place of the scheme's.")] = "",
    set_: Annotated[
        list[str], typer.Option("--set", help="Any value of the scenario: schemes.proposed.observer.L1=0.")
    ] = [],  # noqa: B006
    gains: GainsOption = "",
    bag: Annotated[
        Path | None, typer.Option(help="Recorded run: its bounds, and the Lyapunov functions along it.")
    ] = None,
    output: Annotated[
        Output, typer.Option(help="Model output y: angles and rates, or the paper's angles alone.")
    ] = Output.imu,
    isolability: Annotated[
        bool,
        typer.Option("--isolability", help="Instead: which faults can be detected and told apart."),
    ] = False,
    sensors: Annotated[str, typer.Option(help="For --isolability: sensors, by comma.")] = "attitude,gyro",
    as_json: Annotated[bool, typer.Option("--json", help="For machines.")] = False,
) -> None:
    """Say where the theory holds: one line for each condition, with its numbers."""
    if isolability:
        _isolability(load_scenario(find_scenario(target), set_).vehicle, sensors, as_json)
        raise typer.Exit(GOOD)
    choices = (scheme, observer, disturbance_observer, controller, gains, *set_)
    recorded = bag or (Path(target) if _is_bag(Path(target)) else None)
    if recorded is None:
        report = _of_scenario(target, scheme, observer, disturbance_observer, controller, set_, gains, output)
    else:
        if any(choices):
            raise BagError(
                f"{recorded}: a recorded run is judged as it was flown; no scheme, parts, --gains, --set"
            )
        run = read_run(recorded)
        for warning in run.warnings:
            console(stderr=True).print(f"warning: {warning}", markup=False, soft_wrap=True)
        if bag is not None and (asked := load_scenario(find_scenario(target), []).name) != run.scenario.name:
            raise BagError(f"{bag}: is a run of scenario '{run.scenario.name}', not of '{asked}'")
        report = check_run(run, output.value)
    if as_json:
        console().print(json.dumps(report.to_dict(), indent=2, allow_nan=False), markup=False, soft_wrap=True)
    else:
        _print(report)
    raise typer.Exit(GOOD if report.passed else CHECK_FAILED)


def _of_scenario(
    target: str,
    scheme: str,
    observer: str,
    disturbance_observer: str,
    controller: str,
    overrides: list[str],
    gains: str,
    output: Output,
) -> CheckReport:
    loaded: Scenario = load_scenario(find_scenario(target), overrides, gains)
    for change, kind in (
        (with_observer, observer),
        (with_disturbance_observer, disturbance_observer),
        (with_controller, controller),
    ):
        loaded = change(loaded, kind) if kind else loaded
    return check_scenario(loaded, loaded.scheme(scheme or None), output.value)


def _isolability(vehicle: str, sensors: str, as_json: bool) -> None:
    """Print the matrices: disturbances to be told apart, and disturbances that every residual is blind to."""
    from quadftc_theory.isolability import analyse
    from quadftc_theory.isolability_table import LEGEND, isolability_lines, isolability_table
    from quadftc_theory.vehicle_equations import Assumptions

    names = tuple(name.strip() for name in sensors.split(",") if name.strip())
    results = [
        analyse(load_vehicle(vehicle), Assumptions(sensor_set=names, disturbances=role))
        for role in ("faults", "unknown_inputs")
    ]
    screen = console()
    if as_json:
        found = [result.to_dict() for result in results]
        screen.print(json.dumps(found, indent=2, allow_nan=False), markup=False, soft_wrap=True)
        return
    for result in results:
        heading, *findings = isolability_lines(result)
        screen.print(heading, markup=False, soft_wrap=True)
        screen.print(isolability_table(result))
        for line in findings:
            screen.print(line, markup=False, soft_wrap=True)
        screen.print()
    screen.print(LEGEND, markup=False, soft_wrap=True)


def _is_bag(path: Path) -> bool:
    """Whether a target is meant as a bag: a directory, or a file that is no scenario."""
    return path.is_dir() or (path.is_file() and path.suffix not in (".yaml", ".yml"))


def _print(report: CheckReport) -> None:
    screen = console()
    screen.print(
        f"{report.scenario}, scheme {report.scheme}" + (f", {report.bag}" if report.bag else ""), markup=False
    )
    for section in report.sections:
        screen.print(f"\n[bold]{section.title}[/]")
        for item in section.conditions:
            colour = COLOURS[item.verdict] if item.needed or item.verdict is not Verdict.FAIL else "yellow"
            screen.print(f"  [{colour}]{item.verdict.value:7}[/] ", end="")
            screen.print(f"{item.name}: {item.text}", markup=False, soft_wrap=True)
    failed = [item.name for section in report.sections for item in section.conditions if item.failed]
    verdict = "every condition that the scheme needs holds" if not failed else f"fails: {'; '.join(failed)}"
    screen.print(f"\n{'[green]PASS[/]' if not failed else '[red]FAIL[/]'} ", end="")
    screen.print(verdict, markup=False, soft_wrap=True)
