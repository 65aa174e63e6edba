"""The report of a campaign: one HTML file with tables, figures and the flights worth another look.

>>> write_campaign_report(campaign, frame, summary, Path("results/demo"), "campaigns/demo.yaml")

Importing this package is quick; what draws and renders is loaded when a report is written.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from quadftc_report.report import ReportError

if TYPE_CHECKING:
    import polars as pl

    from quadftc_campaign.campaign_file import Campaign

__all__ = ["write_campaign_report"]

PAGE = "report.html"


def write_campaign_report(
    campaign: Campaign, frame: pl.DataFrame, summary: dict[str, Any], directory: Path, command_file: str
) -> Path:
    """Write the report of a campaign; it needs no other file and no network.

    Parameters
    ----------
    campaign : Campaign
    frame : polars.DataFrame
        Its table (`quadftc_campaign.table`).
    summary : dict
        Of that table (`quadftc_campaign.table.summary_of`).
    directory : Path
        Of the campaign; an earlier report in it is replaced.
    command_file : str
        The campaign file as the user names it, for the commands that fly a flight again.

    Returns
    -------
    Path
        ``DIRECTORY/report.html``.

    Raises
    ------
    ReportError
        If it cannot be written.
    """
    from quadftc_report.campaign.campaign_page import render
    from quadftc_report.campaign.results import results_of

    text = render(results_of(campaign, frame, summary), directory, command_file)
    path = directory / PAGE
    part = directory / f".{PAGE}.part"
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise ReportError(f"{path}: cannot be written: {error.strerror or error}") from None
    return path
