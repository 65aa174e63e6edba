# pyright: basic
"""``quadftc campaign``."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console
from rich.table import Table
from typer import Argument, Option

from quadftc_campaign.errors import CampaignError
from quadftc_cli.commands import INTERRUPTED
from quadftc_cli.commands.options import JunitOption, WorkersOption, workers_here
from quadftc_cli.screen import Bars, console, plain_table, warn

if TYPE_CHECKING:
    from quadftc_campaign.campaign_file import Campaign
    from quadftc_flight.diagnosis_metrics.columns import Metrics
    from quadftc_report.campaign_results import Results, Side

SHOWN = "tracking_rmse_deg", "fault_estimate_rmse_deg"  # median and 95 % of their worst axes
PAIR = "median\u00a0/\u00a095\u00a0%"  # without a break
COLUMNS = (
    *("flights", "lost", "missed faults", f"detection delay [s]: {PAIR}", "false alarms an hour"),
    f"tracking RMSE of the worst axis [deg]: {PAIR}",
    f"RMSE of the fault estimate, worst axis [deg]: {PAIR}",
)


def campaign(
    file: Annotated[Path, Argument(help="Campaign file (see campaigns/).")],
    out: Annotated[Path | None, Option(help="Directory of the results; default: results/NAME.")] = None,
    flights: Annotated[int | None, Option(help="Number of flights in place of the file's.")] = None,
    seed: Annotated[int | None, Option(help="Seed in place of the file's: other draws.")] = None,
    resume: Annotated[bool, Option("--resume", help="Go on with what is in the directory.")] = False,
    workers: WorkersOption = None,
    flight: Annotated[
        list[int],
        Option(help="Fly this one alone, through the node graph, and write its bag; may be repeated."),
    ] = [],  # noqa: B006
    variant: Annotated[
        list[str],
        Option(help="Fly this one alone, of all or of that flight (else its first); may be repeated."),
    ] = [],  # noqa: B006
    force: Annotated[bool, Option("--force", help="Replace an earlier run of that flight.")] = False,
    recordings: Annotated[
        Path | None, Option(help="Directory of rosbag2 bags for a campaign on recordings.")
    ] = None,
    junit: JunitOption = None,
    engine: Annotated[
        Literal["c", "numpy", "jax"] | None,
        Option(help="What runs the laws; default: JAX where it has a GPU, else C that is generated."),
    ] = None,
) -> None:
    """Fly a scenario thousands of times with drawn values; write table, summary and report.

    The exit code is 1 if a check of the file fails.
    """
    from quadftc_campaign.campaign_file import load_campaign  # with what it needs, half a second
    from quadftc_campaign.flights import flight_scenario, variant_of

    loaded = load_campaign(file, flights, recordings, seed, engine)
    directory = out or Path("results") / loaded.name
    if variant:
        some = tuple(variant_of(loaded, name) for name in dict.fromkeys(variant))
        loaded = loaded.model_copy(update={"variants": some})
    if flight:
        from quadftc_cli.flying import fly_jobs
        from quadftc_flight.runs import RunOptions

        if loaded.source.kind != "loop":
            raise CampaignError("--flight: flies the closed loop; this campaign has samples alone")
        if len(variant) > 1:
            raise CampaignError(f"--variant: {len(variant)} given; expected one at most with --flight")
        if engine == "jax":
            raise CampaignError("--engine jax: flies batches; expected c or numpy with --flight")
        chosen = loaded.variants[0]
        scenarios = [flight_scenario(loaded, number, chosen) for number in dict.fromkeys(flight)]
        jobs = [(scenario, scenario.scheme(chosen.scheme)) for scenario in scenarios]
        how = RunOptions(force=force, engine=engine or "c")
        raise typer.Exit(fly_jobs(jobs, directory / "runs", how, junit=junit))
    raise typer.Exit(_fly_all(loaded, file, directory, resume, workers, junit))


def _fly_all(
    loaded: Campaign, file: Path, directory: Path, resume: bool, workers: int | None, junit: Path | None
) -> int:
    cores = workers_here(workers)
    from quadftc_campaign.campaign_run import CampaignRun
    from quadftc_cli.judging import judge
    from quadftc_report.campaign_results import results_of
    from quadftc_report.report import write_campaign_report

    screen = console()
    flown = CampaignRun(loaded, directory)
    extents = f"{loaded.flights} flights x {len(loaded.variants)} variants"
    screen.print(f"{loaded.name}: {extents}, by {loaded.engine}, {loaded.flown_precision}")
    extent = flown.open(resume)
    warn(extent.damaged)
    where = f"{min(cores, max(extent.missing, 1))} of {len(os.sched_getaffinity(0))} cores"
    screen.print(f"{extent.missing} of {extent.chunks} chunks to fly; starting workers on {where}")
    phase = "compiling, then flying" if loaded.engine == "jax" else "flying"
    started, steps = time.monotonic(), list[int]()

    def advance(samples: int) -> None:
        steps.append(samples)
        rate = sum(steps) / (time.monotonic() - started)
        update(sum(steps) / max(extent.samples, 1), f"{rate / 1e6:.2f} M steps/s")

    try:
        with Bars(screen) as bars:
            update = bars.add("flying")
            flown.fly(cores, advance, lambda devices: screen.print(f"{phase} on {devices}"))
    except KeyboardInterrupt:
        screen.print(f"interrupted; --resume goes on with what is in {directory}")
        return INTERRUPTED
    # chunks of earlier calls count, too; only what was flown now has a rate
    seconds = time.monotonic() - started
    frame, summary = flown.finish()
    report = write_campaign_report(loaded, frame, summary, directory, str(file))
    if extent.missing:
        flown_steps = f"{extent.samples:.3g} closed-loop steps in {seconds:.1f} s"
        cost = f"{flown_steps}: {extent.samples / seconds:.3g} a second"
        screen.print(cost if loaded.source.kind == "loop" else f"flown in {seconds:.1f} s")
    results = results_of(loaded, frame, summary)
    screen.print(_table(results, screen))
    screen.print(f"{frame.height} rows: {directory / 'flights.parquet'}")
    screen.print(f"numbers: {directory / 'summary.json'}; report: {report}")
    checks = {f"{loaded.name}-{side.name}": results.checks.get(side.name, ()) for side in results.sides}
    return judge(checks, screen, junit, "campaign")


def _table(results: Results, screen: Console) -> Table:
    """Table of variants: as many columns as the screen has room for, the most telling first."""
    from quadftc_cli.metric_table import fitting, in_short_lines
    from quadftc_report.wording import NOTHING

    rows = {side.name: _cells(side) for side in results.sides}
    headings = [name for name in COLUMNS if any(cells[name] is not None for cells in rows.values())]

    def table(count: int) -> Table:
        made = plain_table(("variant",), map(in_short_lines, headings[:count]))
        for name, cells in rows.items():
            made.add_row(name, *(cells[each] or NOTHING for each in headings[:count]))
        return made

    return fitting((table(count) for count in range(len(headings), 0, -1)), screen)


def _cells(side: Side) -> dict[str, str | None]:
    """Write the numbers of a variant as the page does, by `COLUMNS`; None where there is none."""
    from quadftc_report.wording import short

    each = side.summary
    faults, lost = each["faults"].get("all", {}), each.get("lost")
    tracking, estimate = (_pair(_worst(each["metrics"], name)) for name in SHOWN)
    found = (
        str(each["flights"]),
        None if lost is None else str(lost),
        f"{faults['missed']} of {faults['judged']}" if faults else None,
        _pair(faults.get("metrics", {}).get("fault.detection_delay_s", {})),
        short(side.alarms_per_hour()) if side.has_observer else None,
        tracking,
        estimate,
    )
    return dict(zip(COLUMNS, found, strict=True))


def _worst(metrics: Metrics, name: str) -> Metrics:
    from quadftc_model.samples import AXES

    axes = [metrics[f"{name}.{axis}"] for axis in AXES]
    return max(axes, key=lambda each: each.get("q50", -math.inf))


def _pair(values: Metrics) -> str | None:
    from quadftc_report.wording import short

    return f"{short(values['q50'])} / {short(values['q95'])}" if values.get("count") else None
