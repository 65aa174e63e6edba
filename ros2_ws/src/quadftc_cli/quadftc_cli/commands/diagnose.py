# pyright: basic
"""``quadftc diagnose``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from quadftc_cli.commands import CHECK_FAILED, GOOD, NOT_ENOUGH, options
from quadftc_cli.screen import Bars, console, plain_table, say

if TYPE_CHECKING:
    from quadftc_replay.inspection.verdict import Verdict

SHOWN = 40  # moments of the timeline on the screen
EXIT_CODES = {"healthy": GOOD, "fault": CHECK_FAILED, "not enough to say": NOT_ENOUGH}
FAULT_HELP = "Overlay a fault: 'bias channel=gyro axis=roll value=0.3 start=20s'; may be repeated."


Log = Annotated[Path, Argument(metavar="LOG", help=options.LOG_HELP)]
Baseline = Annotated[
    Path | None, Option(metavar="LOG", help="Healthy flight of the same vehicle, to compare the rotors with.")
]
BaselineLog = Annotated[
    int,
    Option(min=0, metavar="N", show_default=False, help="Which of several logs in the file of the baseline."),
]
Fault = Annotated[list[str], Option(metavar="SPEC", help=FAULT_HELP)]
VehicleName = Annotated[
    str, Option(help="Vehicle, by name or TOML file, for the layout of the rotors; default: the log's.")
]
Seed = Annotated[int, Option(help="Seed of random faults.")]
FalseAlarms = Annotated[
    str,
    Option(
        metavar="N/TIME",
        help="At most N healthy flights in TIME may have a finding: 1/5h. Default: no bound.",
    ),
]
Out = Annotated[
    Path | None,
    Option(
        help="Page, with its verdict as .json beside it; or a directory for report.html and verdict.json;"
        " default: results/LOG-diagnosis.",
        metavar="FILE.html|DIR",
    ),
]
Junit = Annotated[Path | None, Option(metavar="FILE", help="Write the verdict as JUnit XML, too.")]
HasReport = Annotated[bool, Option(help="Write report.html beside the verdict.")]


def diagnose(
    log: Log,
    number: options.NumberOption = 0,
    system: options.SystemOption = 0,
    mapping: options.MappingOption = None,
    baseline: Baseline = None,
    baseline_log: BaselineLog = 0,
    fault: Fault = [],  # noqa: B006
    vehicle: VehicleName = "",
    seed: Seed = 0,
    false_alarms: FalseAlarms = "",
    out: Out = None,
    junit: Junit = None,
    report: HasReport = True,
) -> int:
    """Say what failed in a flight log, when, how badly and how sure.

    The exit code is 0 for a healthy flight, 1 with a finding, 4 if the log does not hold enough to say.
    """
    options.ask_for_files(log, baseline, mapping)
    from quadftc_replay.inspection.diagnosis import (
        VERDICT,
        DiagnosisOptions,
        diagnose_log,
        write_verdict,
        write_verdict_junit,
    )
    from quadftc_replay.readers import LogChoice

    how = DiagnosisOptions(
        choice=LogChoice(number, system, mapping),
        baseline=baseline,
        baseline_log=baseline_log,
        faults=tuple(fault),
        vehicle=vehicle,
        seed=seed,
        false_alarms=false_alarms,
    )
    with Bars(console()) as bars:
        inspection = diagnose_log(log, how, bars.add(log.resolve().name))
    verdict = inspection.verdict
    _show(verdict)
    # the verdict beside PAGE.html is PAGE.json
    place = out or Path("results", f"{log.resolve().name}-diagnosis")
    page = options.page_at(place)
    name = page.with_suffix(".json").name if page == place else VERDICT
    written = [write_verdict(verdict, page.parent, name)]
    if report:
        from quadftc_report.verdict_page import write_page

        written.append(write_page(inspection, page.parent, page.name))
    if junit is not None:
        written.append(write_verdict_junit(verdict, junit))
    say(f"written: {', '.join(map(str, written))}")
    return EXIT_CODES[verdict.outcome]


def _show(verdict: Verdict) -> None:
    from quadftc_replay.inspection.verdict import show, unsaid

    say(verdict.sentence)
    if verdict.findings:
        table = plain_table(
            ["component", "kind"], ["onset [s]", "end [s]", "size", "sigma", "probability", "or"]
        )
        for each in verdict.findings:
            size, sigma = (
                "-" if value is None else show(value, each.unit) for value in (each.size, each.sigma)
            )
            end = "-" if each.end_s is None else f"{each.end_s:.3f}"
            others = ", ".join(each.ambiguous_with) or "-"
            probability = f"{100 * each.probability:.0f} %"
            table.add_row(each.name, each.kind, f"{each.onset_s:.3f}", end, size, sigma, probability, others)
        console().print(table)
        say(*(f"{each.name}: {line}" for each in verdict.findings for line in each.evidence))
    if len(verdict.timeline) > 1:
        shown = verdict.timeline[:SHOWN]
        say("timeline:", *(f"  {each.time_s:8.2f} s  {each.source}: {each.text}" for each in shown))
    say(*(f"not judged: {each.component}: {each.reason}" for each in unsaid(verdict)))
    say(*(f"for the next flight: {each}" for each in verdict.advice))
    say(*(f"note: {note}" for note in verdict.notes))
