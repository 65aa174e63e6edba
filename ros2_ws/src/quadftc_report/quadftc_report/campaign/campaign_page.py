# pyright: basic
"""The report of a campaign as one HTML page."""

from __future__ import annotations

from pathlib import Path

from plotly.offline import get_plotlyjs

from quadftc_report.campaign.campaign_figures import pictures
from quadftc_report.campaign.campaign_statements import result_sentences
from quadftc_report.campaign.campaign_tables import fault_table, flight_table
from quadftc_report.campaign.flown_words import flown
from quadftc_report.campaign.results import Results
from quadftc_report.campaign.worst import drawn_headings, rankings
from quadftc_report.templating import environment
from quadftc_report.wording import counted

PACKAGE = "quadftc_report.campaign.report"


def render(results: Results, directory: Path, command_file: str) -> str:
    """Return the page: HTML that needs no other file.

    Parameters
    ----------
    results : Results
    directory : Path
        Of the campaign, for the commands that fly a flight again.
    command_file : str
        The campaign file as the user names it.
    """
    campaign = results.campaign
    figures = pictures(results)
    template = environment(PACKAGE).get_template("campaign.html")
    return template.render(
        name=campaign.name,
        description=campaign.description.strip(),
        extent=f"{counted(campaign.flights, 'flight')} of {counted(len(results.sides), 'variant')}",
        sentences=result_sentences(results),
        facts=flown(results),
        faults=fault_table(results),
        flights=flight_table(results),
        pictures=figures,
        sections=[key for key, shown in figures.items() if shown],
        rankings=rankings(results, directory, command_file),
        drawn=drawn_headings(campaign),
        without_observer=results.without_observer,
        plotly_js=get_plotlyjs(),
    )
