# pyright: basic
"""``quadftc report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from quadftc_cli.commands import options
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
        Path, Option(metavar="FILE.html|DIR", help="The page, or a directory for report.html; replaced.")
    ] = Path("report.html"),
    figures: Annotated[
        bool, Option(help="Write the figures as PNG and PDF, too, into a directory beside the page.")
    ] = False,
    figure: Annotated[
        list[str],
        Option(
            metavar="KEY",
            help="Draw this figure alone, without a page: its key (paper_faults-tracking-roll), or its"
            " number in the paper (3 to 14); may be repeated.",
        ),
    ] = [],  # noqa: B006
) -> None:
    """Compare recorded runs and replays: one HTML page with figures and metrics, side by side.

    Runs of one scenario share figures and tables, with checks and what they say of the paper; so do replays
    of one recording. The page needs no network.
    """
    from quadftc_report.report import figures_beside, write_figures, write_report
    from quadftc_report.wording import counted, listing

    out = options.page_at(out)
    with Bars(console()) as bars:
        update = bars.add("report")

        def progress(what: str, share: float) -> None:
            update(share, what)

        if figure:  # alone, without reading what else a page needs
            drawn = write_figures(bags, figures_beside(out), figure, progress=progress)
            say(*(f"figure: {file}" for file in drawn))
            return
        written = write_report(bags, out, with_figures=figures, progress=progress)
    warn(written.warnings)
    pairs = ((len(written.runs), "run"), (len(written.replays), "replay"))
    counts = listing([counted(number, what) for number, what in pairs if number])
    say(*written.verdicts, f"report on {counts}: {written.page}")
    if written.figures is not None:
        say(f"figures (PNG, PDF): {written.figures}")
