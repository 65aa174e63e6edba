# pyright: basic
"""``quadftc report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from quadftc_cli.screen import Bars, console, say, warn


def report(
    bags: Annotated[
        list[Path],
        Argument(
            metavar="BAG|DIR",
            help="Runs and replays (rosbag2 directories, .mcap files), or directories of such.",
        ),
    ],
    out: Annotated[
        Path, Option(help="The HTML file; an earlier one is replaced.", metavar="FILE.html")
    ] = Path("report.html"),
    figures: Annotated[
        bool, Option(help="Write the figures as PNG and PDF, too, into a directory beside the page.")
    ] = True,
) -> None:
    """Compare recorded runs and replays: one HTML page with figures and metrics, side by side.

    Runs of one scenario share figures and tables, with checks and what they say of the paper; so do replays
    of one recording. The page needs no network.
    """
    from quadftc_report.report import write_report
    from quadftc_report.wording import counted, listing

    with Bars(console()) as bars:
        update = bars.add("report")
        written = write_report(
            bags, out, with_figures=figures, progress=lambda what, share: update(share, what)
        )
    warn(written.warnings)
    pairs = ((len(written.runs), "run"), (len(written.replays), "replay"))
    counts = listing([counted(number, what) for number, what in pairs if number])
    say(f"report on {counts}: {written.page}")
    if written.figures is not None:
        say(f"figures (PNG, PDF): {written.figures}")
