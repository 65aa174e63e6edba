"""The report: recorded runs side by side, as one HTML file and as figures for print.

>>> write_report([Path("results/demo")], Path("report.html"))

Importing this package is quick; what draws and renders is loaded when a report is written.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from quadftc_bench.recorded_run import find_runs, read_run

if TYPE_CHECKING:
    from quadftc_bench.report.page import Section

__all__ = ["ReportError", "ReportFiles", "write_report"]

SUFFIXES = (".html", ".htm")
READING = 0.3  # share of the work; the rest is drawing

Progress = Callable[[str, float], None]
Item = TypeVar("Item")


class ReportError(ValueError):
    """A report that cannot be written; one line that says why."""


@dataclasses.dataclass(frozen=True)
class ReportFiles:
    """What was written.

    Parameters
    ----------
    page : Path
        The HTML file.
    figures : Path, optional
        The directory of the figures for print; None: none were asked for.
    runs : tuple of str
        Names of the runs in the report.
    warnings : tuple of str
        One line each; they are on the page, too.
    """

    page: Path
    figures: Path | None
    runs: tuple[str, ...]
    warnings: tuple[str, ...]


def write_report(
    paths: Sequence[Path],
    out: Path,
    *,
    with_figures: bool = True,
    progress: Progress = lambda _what, _share: None,
) -> ReportFiles:
    """Write the report on recorded runs.

    The page needs no other file and no network. The same figures are written as PNG and PDF into a directory
    beside it. Nothing is in its place before all is written.

    Parameters
    ----------
    paths : sequence of Path
        Runs, or directories of runs.
    out : Path
        The HTML file; an earlier one is replaced.
    with_figures : bool
        Whether to write the figures for print.
    progress : callable
        Called with what is being done, and the share of the work that is done.

    Raises
    ------
    BagError
        If a path holds no run, or one that cannot be read.
    ReportError
        If the report cannot be written where it is asked for.
    """
    folder = out.parent / f"{out.stem}_figures"
    _check_place(out, folder)
    found = find_runs(paths)
    runs = [read_run(path) for path in _followed(found, str, progress, 0.0, READING)]
    warnings = tuple(line for run in runs for line in run.warnings)

    from quadftc_bench.report.comparison import compare
    from quadftc_bench.report.page import render, sections

    parts = sections(compare(runs), folder.name if with_figures else None)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.stem}_", dir=out.parent) as name:
            made = Path(name)
            (made / out.name).write_text(render(parts, warnings), encoding="utf-8")
            if with_figures:
                _draw(parts, made / folder.name, progress)
                _move_all(made / folder.name, folder)
            (made / out.name).replace(out)
    except OSError as error:
        raise ReportError(f"{out}: cannot be written: {error.strerror or error}") from None
    return ReportFiles(out, folder if with_figures else None, tuple(run.name for run in runs), warnings)


def _check_place(out: Path, folder: Path) -> None:
    """Refuse a place before any work is done."""
    if out.is_dir():
        raise ReportError(f"{out}: is a directory; expected the name of a file in it, such as report.html")
    if out.suffix.lower() not in SUFFIXES:
        raise ReportError(f"{out}: expected a name that ends in .html")
    if folder.exists() and not folder.is_dir():
        raise ReportError(f"{folder}: is in the way; the figures go into a directory of that name")
    above = next(place for place in (out.parent, *out.absolute().parents) if place.exists())
    if not above.is_dir():
        raise ReportError(f"{out}: {above} is not a directory")
    for place in (above, *(each for each in (folder, out) if each.exists())):
        if not os.access(place, os.W_OK):
            raise ReportError(f"{place}: may not be written to")


def _draw(parts: Sequence[Section], folder: Path, progress: Progress) -> None:
    from quadftc_bench.report.draw_matplotlib import save_figure

    folder.mkdir()
    drawings = [drawing.figure for part in parts for drawing in part.drawings]
    for figure in _followed(drawings, lambda each: each.key, progress, READING, 1.0):
        save_figure(figure, folder)


def _move_all(source: Path, target: Path) -> None:
    """Put files into a directory; others that are there stay."""
    target.mkdir(exist_ok=True)
    for file in source.iterdir():
        file.replace(target / file.name)


def _followed(
    items: Sequence[Item], name: Callable[[Item], str], progress: Progress, start: float, stop: float
) -> Iterator[Item]:
    """Yield items, and say before each what is being done."""
    for index, item in enumerate(items):
        progress(name(item), start + (stop - start) * index / len(items))
        yield item
