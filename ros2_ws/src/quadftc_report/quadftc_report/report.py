"""Reports as one HTML file: recorded runs and replays side by side, or the flights of a campaign.

>>> write_report([Path("results/demo")], Path("report.html"))
>>> write_campaign_report(campaign, frame, summary, Path("results/demo"), "campaigns/demo.yaml")

The libraries that draw and render are loaded when a report is written.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quadftc_bags.bag import BagError, read_bag
from quadftc_flight.junit import write_file
from quadftc_flight.live_run import is_live, live_run
from quadftc_flight.run_directory import MissingPartError, RecordedRun, find_runs, is_replay, run_from_bag
from quadftc_replay.replay_directory import RecordedReplay, replay_from_bag

if TYPE_CHECKING:
    import polars as pl

    from quadftc_campaign.campaign_file import Campaign
    from quadftc_flight.summary import Summary
    from quadftc_report.description import Figure
    from quadftc_report.page import Section

SUFFIXES = (".html", ".htm")
READING = 0.3  # share of the work; the rest is drawing

Progress = Callable[[str, float], None]


class ReportError(ValueError):
    """A report that cannot be written; one line that says why."""


class ReportFiles(NamedTuple):
    """The files written, the names of the runs and replays in them, and what the page says first."""

    page: Path
    figures: Path | None  # directory of the figures for print
    runs: tuple[str, ...]
    replays: tuple[str, ...]
    warnings: tuple[str, ...]  # one line each
    verdicts: tuple[str, ...]  # a sentence on each scenario and recording


def write_report(
    paths: Sequence[Path],
    out: Path,
    *,
    with_figures: bool = False,
    progress: Progress = lambda _what, _share: None,
) -> ReportFiles:
    """Write the report on recorded runs and replays: a page that needs no other file and no network.

    ``paths`` are runs and replays, or directories of such; one without any raises BagError. No file is
    replaced before all are written. ``with_figures``: a directory beside the page gets the figures for print
    (PNG, PDF). ``progress`` is called with the current task and the share of the work that is done.
    """
    # refuse a place before anything is read or drawn
    folder = figures_beside(out)
    _check_place(out, folder)
    found = _gather(paths, progress)

    from quadftc_report.headline import headline
    from quadftc_report.page import render

    page = render(found.flown, found.warnings, found.replayed, folder.name if with_figures else None)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        # beside the target, then moved: a report that fails leaves the old one as it is
        with tempfile.TemporaryDirectory(prefix=f".{out.stem}_", dir=out.parent) as name:
            made = Path(name, out.name)
            made.write_text(page, encoding="utf-8")
            if with_figures:
                _draw(found.figures, folder, Path(name, folder.name), progress)
            made.replace(out)
    except OSError as error:
        raise ReportError(f"{out}: cannot be written: {error.strerror or error}") from None
    names = ([run.name for part in parts for run in part.comparison.runs] for parts in found[:2])
    flown, replayed = map(tuple, names)
    verdicts = [f"{each.title}: {headline(each.comparison).sentence}" for each in (*found[0], *found[1])]
    files = out, folder if with_figures else None
    return ReportFiles(*files, flown, replayed, found.warnings, tuple(verdicts))


def write_figures(
    paths: Sequence[Path],
    folder: Path,
    chosen: Sequence[str],
    *,
    progress: Progress = lambda _what, _share: None,
) -> list[Path]:
    """Draw some figures of recorded runs and replays, without a page; return the files (PNG, PDF).

    ``chosen`` are keys of figures, such as ``paper_faults-tracking-roll``, or numbers in the paper.
    """
    _check_folder(folder)
    found = _gather(paths, progress)
    figures: list[Figure] = []
    for key in chosen:
        fitting = [each for each in found.figures if key in (each.key, *map(str, each.paper_figures))]
        if not fitting:
            there = ", ".join(each.key for each in found.figures) or "none"
            raise ReportError(f"no figure '{key}' of these runs; there are: {there}")
        figures += fitting
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}_", dir=folder.parent) as name:
            return _draw(figures, folder, Path(name), progress)
    except OSError as error:
        raise ReportError(f"{folder}: cannot be written: {error.strerror or error}") from None


def figures_beside(out: Path) -> Path:
    """Return the directory of the figures of a page."""
    return out.parent / f"{out.stem}_figures"


class _Gathered(NamedTuple):
    """What there is to show, scenario by scenario and recording by recording."""

    flown: list[Section]
    replayed: list[Section]
    warnings: tuple[str, ...]

    @property
    def figures(self) -> list[Figure]:
        return [figure for part in (*self.flown, *self.replayed) for figure in part.figures]


def _gather(paths: Sequence[Path], progress: Progress) -> _Gathered:
    """Read runs and replays, and describe their figures."""
    runs, replays, left_out = _read_all(find_runs(paths), progress)
    warnings = (*left_out, *(line for each in (*runs, *replays) for line in each.warnings))

    from quadftc_report.comparison import compare
    from quadftc_report.page import flight_sections, replay_sections

    parts = flight_sections(compare(runs))
    return _Gathered(parts, replay_sections(compare(replays, [part.key for part in parts])), warnings)


def _draw(figures: Sequence[Figure], folder: Path, made: Path, progress: Progress) -> list[Path]:
    """Draw figures for print in the directory ``made``, then move them into ``folder``."""
    from quadftc_report.draw_matplotlib import save_figure

    drawn: list[Path] = []
    for index, figure in enumerate(figures):
        progress(figure.key, READING + (1.0 - READING) * index / len(figures))
        drawn += save_figure(figure, made)
    folder.mkdir(exist_ok=True)
    return [file.replace(folder / file.name) for file in drawn]


def _read_all(
    found: Sequence[Path], progress: Progress
) -> tuple[list[RecordedRun], list[RecordedReplay], list[str]]:
    """Read runs and replays; of several, one with a component that is not installed here is left out."""
    runs: list[RecordedRun] = []
    replays: list[RecordedReplay] = []
    left_out: list[str] = []
    for index, path in enumerate(found):
        progress(str(path), READING * index / len(found))
        bag = read_bag(path)
        try:
            if is_replay(bag):
                replays.append(replay_from_bag(bag))
            else:
                runs.append(live_run(bag) if is_live(bag) else run_from_bag(bag))
        except MissingPartError as error:
            if len(found) == 1:
                raise
            left_out.append(f"left out: {error}")
    if not runs and not replays:
        raise BagError("\n".join(left_out))
    return runs, replays, left_out


def write_campaign_report(
    campaign: Campaign, frame: pl.DataFrame, summary: Summary, directory: Path, command_file: str
) -> Path:
    """Write ``DIRECTORY/report.html`` on the table and summary of a campaign; return its path.

    ``command_file``: the campaign file as the user names it, for the commands that fly a flight again.
    """
    from quadftc_report.campaign_page import render_campaign
    from quadftc_report.campaign_results import results_of

    text = render_campaign(results_of(campaign, frame, summary), directory, command_file)
    path = directory / "report.html"
    try:
        return write_file(path, text)
    except OSError as error:
        raise ReportError(f"{path}: cannot be written: {error.strerror or error}") from None


def _check_place(out: Path, folder: Path) -> None:
    """Refuse a place before any work is done."""
    if out.is_dir():
        raise ReportError(f"{out}: is a directory; expected the name of a file in it, such as report.html")
    if out.suffix.lower() not in SUFFIXES:
        raise ReportError(f"{out}: expected a name that ends in .html")
    _check_folder(folder)
    above = next(place for place in (out.parent, *out.absolute().parents) if place.exists())
    if not above.is_dir():
        raise ReportError(f"{out}: {above} is not a directory")
    for place in (above, *(each for each in (folder, out) if each.exists())):
        if not os.access(place, os.W_OK):
            raise ReportError(f"{place}: may not be written to")


def _check_folder(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise ReportError(f"{folder}: is in the way; expected a directory, or a name that is free")
