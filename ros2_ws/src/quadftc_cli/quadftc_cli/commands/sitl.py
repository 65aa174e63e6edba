# pyright: basic
"""``quadftc sitl``."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console
from typer import Argument, Option

from quadftc_cli.commands import BAD_INPUT, INTERNAL, options
from quadftc_cli.screen import Bars, console, plain_table, say

if TYPE_CHECKING:
    from quadftc_flight.summary import Summary
    from quadftc_sitl.scoring import Told
    from quadftc_sitl.sitl_report import Drawn

SAID = 12  # words of the autopilot on the screen


Flown = Annotated[
    str,
    Argument(
        help="Scenario of free flight: a file, or a name. Or a campaign file with 'source: sitl'.",
        autocompletion=options.complete_scenario,
    ),
]
Firmware = Annotated[Literal["ardupilot", "px4"], Option(help="Whose firmware it is.")]
Binary = Annotated[Path, Option(metavar="FILE", help="Its simulation (SITL), such as arducopter or px4.")]
Parameters = Annotated[
    list[Path], Option(metavar="FILE", help="Parameters of the firmware, NAME VALUE a line; may be repeated.")
]
SchemeName = Annotated[str, Option(help="Whose observer runs beside; default: the scenario's first.")]
Guard = Annotated[
    list[str],
    Option(
        metavar="FINDING=ACTION",
        help="What is done when our observer names a fault, such as gyro=land; may be repeated.",
    ),
]
Seed = Annotated[str, Option(help="Seed of the random numbers.")]
Catalogue = Annotated[
    bool, Option("--catalogue", help="Fly all of the scenario's catalogue, not the scenario.")
]
Only = Annotated[
    str, Option(help="Of the catalogue or campaign, the flights of these names, such as 'gyro_*'.")
]
Seeds = Annotated[
    int | None,
    Option(min=1, help="Flights of each fault of the catalogue, or of the campaign, in place of its own."),
]
Jobs = Annotated[int, Option(min=1, help="Flights side by side.")]
Resume = Annotated[bool, Option("--resume", help="Keep the flights that were flown before.")]
Force = Annotated[bool, Option("--force", help="Replace flights that were flown before.")]
Out = Annotated[Path, Option(help="Directory of the flights, each in its own.")]


def sitl(
    scenario: Flown,
    autopilot: Firmware,
    binary: Binary,
    parameters: Parameters = [],  # noqa: B006
    scheme: SchemeName = "",
    set_: options.SetOption = [],  # noqa: B006
    guard: Guard = [],  # noqa: B006
    seed: Seed = "",
    catalogue: Catalogue = False,
    only: Only = "*",
    seeds: Seeds = None,
    jobs: Jobs = 1,
    resume: Resume = False,
    force: Force = False,
    engine: options.EngineOption = "c",
    out: Out = Path("results"),
    junit: options.JunitOption = None,
) -> None:
    """Let a real autopilot's firmware fly a scenario with faults; say what it noticed and what came of it."""
    from quadftc_flight.scenario import find_scenario
    from quadftc_sitl import catalogue as flights
    from quadftc_sitl.plan import read_parameters
    from quadftc_sitl.sitl_campaign import flights_of_file

    path = find_scenario(scenario)
    if not binary.is_file():
        raise ValueError(f"{binary}: no such file; expected the firmware's simulation")
    changes = [*set_, *(f"autopilot.guard.actions.{each}" for each in guard)]
    given = {name: value for file in parameters for name, value in read_parameters(file).items()}
    plans, drawn = flights_of_file(path, autopilot, scheme, catalogue, seeds, seed, changes)
    if drawn is not None:
        plans = [plan for plan in plans if fnmatch.fnmatch(plan.name.rpartition("-")[0], only)]
    if not plans:
        raise ValueError(f"--only {only}: no such flight in {scenario}")
    todo = [flights.job_of(plan, binary.resolve(), given, out.resolve(), engine) for plan in plans]
    # flights that are to be resumed stay; of others nothing old may be left among the new
    if force and not resume:
        for job in todo:
            flights.clear(job.out)
    screen = console()
    with Bars(screen) as bars:
        update = bars.add(f"{len(todo)} flights" if len(todo) > 1 else todo[0].name)
        found = flights.fly_jobs(todo, jobs, resume, lambda done: update(done / len(todo)))
    if drawn is not None and (lost := flights.write_lost(todo, found, out)):
        say(f"lost, one scenario each: {lost[0].parent}")
    raise typer.Exit(_show(found, out, screen, junit, drawn))


def _show(
    summaries: Sequence[Summary], out: Path, screen: Console, junit: Path | None, drawn: Drawn | None
) -> int:
    """Print what became of flights, write the report of many (``drawn`` not None), return the exit code."""
    from quadftc_cli.judging import judge
    from quadftc_flight.junit import write_file
    from quadftc_sitl.sitl_report import COLUMNS, markdown, table_rows

    flown = [each for each in summaries if "error" not in each]
    failed = [each for each in summaries if "error" in each]
    if drawn is not None and flown:
        table = plain_table(COLUMNS[:1], COLUMNS[1:])
        for row in table_rows(flown):
            table.add_row(*row)
        screen.print(table)
        say(f"report: {write_file(out / 'catalogue.md', markdown(flown, drawn))}")
    elif flown:
        _show_flight(flown[0])
    code = 0
    if flown:
        say(f"flights: {out}")
        code = judge({each["name"]: each["checks"] for each in flown}, screen, junit, "sitl")
    for each in flown:
        if problem := each["recorded"]["problem"]:
            say(f"error: {each['name']}: {problem}", stderr=True)
            code = INTERNAL
    say(*(f"error: {each['name']}: {each['error']}" for each in failed), stderr=True)
    return BAD_INPUT if failed else code


def _show_flight(flight: Summary) -> None:
    """Print the truth of one flight beside what was said of it."""
    for fault in flight["faults"]:
        said, seen, judged = fault["autopilot"], fault["observer"], fault["diagnose"]
        own = "not in what it sees" if seen["named"] is None else _told(seen, ", ".join(seen["as"]))
        say(
            f"{fault['component']} {', '.join(fault['elements'])} from {fault['start']:g} s: {fault['spec']}",
            f"  autopilot: {_told(said, said['words'])}",
            f"  observer:  {own}",
            f"  diagnose:  {_told(judged, ', '.join(judged['as']))}",
        )
    for each in flight["guardian"]["decisions"]:
        what = f"refused, {each['refused']}" if each["refused"] else each["answer"] or "done"
        say(f"guardian: {each['time']:.2f} s  {each['finding']} {each['kind']}: {each['action']}, {what}")
    autopilot = flight["autopilot"]
    say(f"{flight['name']}: {'survived' if flight['survived'] else 'LOST'}, {flight['ended']}")
    said = [event for event in flight["autopilot_said"] if event["serious"] and event["time"] >= 0.0]
    say(*(f"  {event['time']:8.2f} s  {event['words']}" for event in said[:SAID]))
    say(f"diagnose: {flight['diagnose'].get('sentence') or flight['diagnose']['problem']}")
    say(
        f"autopilot: {autopilot['name']} {autopilot['version']}, {flight['real_time_factor']:.1f} x real time"
    )
    if autopilot["open_sockets"]:
        say(f"open to others than this machine: {', '.join(autopilot['open_sockets'])}")


def _told(said: Told, words: str) -> str:
    return f"{words} after {said['delay_s']:.2f} s" if said["delay_s"] is not None else "-"
