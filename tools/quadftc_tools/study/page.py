# pyright: basic
"""What the pages of the studies share: their tables between marks, the look of their figures, the command.

A table stands in the document between <!-- table: NAME --> and <!-- end -->, so that nobody copies a number.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import polars as pl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from quadftc_cli.commands import BAD_INPUT, GOOD
from quadftc_cli.screen import say
from quadftc_fdi.fault_observer import fault_observers
from quadftc_report.draw_matplotlib import STYLE
from quadftc_report.style import line_style

NOTHING = "-"
FLIGHTS = "flights.parquet"
DPI = 200
WIDTH = 7.0  # in; two columns of a journal
LINE_WIDTH = 1.0  # pt
TITLES = {"axes.titlesize": 8.5, "lines.markersize": 4.0}  # beside the style of the report
_BLOCK = re.compile(
    r"(?P<head><!-- table: (?P<name>[\w-]+) -->\n)(?P<body>.*?)(?P<foot><!-- end -->)", re.DOTALL
)

Tables = Mapping[str, str]  # by the name of the place
Drawers = Mapping[str, Callable[[], Figure]]  # by the name of the file
RESULTS: dict[str, Any] = {"type": Path, "required": True, "help": "directory of the campaigns"}


def has_detector(observer: str) -> bool:
    """Whether the status of an observer says what is faulty; else the size of its estimate is taken."""
    return fault_observers.get(observer).has_detector


def read_campaigns(results: Path, names: Sequence[str]) -> dict[str, pl.DataFrame]:
    """Read the tables ``RESULTS/NAME/flights.parquet`` that are there; ValueError if there is none."""
    paths = {name: results / name / FLIGHTS for name in names}
    frames = {name: pl.read_parquet(path) for name, path in paths.items() if path.is_file()}
    if not frames:
        raise ValueError(f"{results}: no study there; expected {names[0]}/{FLIGHTS} or another")
    return frames


def run_study(
    page: str,
    make: Callable[[argparse.Namespace], tuple[Tables, Drawers]],
    arguments: Mapping[str, Mapping[str, Any]],
    given: Sequence[str] | None = None,
) -> int:
    """Make the tables and figures of a study from its arguments; put them into its page, or print them.

    The page is in the directory ``--docs``. Input that is wrong gives a line, and the exit code of such.
    """
    parser = argparse.ArgumentParser(description=f"Tables and figures of docs/{page}.")
    for name, settings in arguments.items():
        parser.add_argument(name, **settings)
    parser.add_argument("--docs", type=Path, help=f"directory of {page}; without it, tables are printed")
    options = parser.parse_args(given)
    try:
        tables, drawers = make(options)
        if options.docs is None:
            say(*(f"{name}\n{table}\n" for name, table in tables.items()))
        else:
            written = publish(options.docs / page, tables, drawers)
            say(*(f"written: {path}" for path in written), stderr=True)
    except (ValueError, OSError) as error:
        say(f"error: {error}", stderr=True)
        return BAD_INPUT
    return GOOD


def publish(page: Path, tables: Tables, drawers: Drawers) -> list[Path]:
    """Write the tables into a page and the figures beside it; return the files."""
    page.write_text(with_tables(page.read_text(encoding="utf-8"), tables, str(page)), encoding="utf-8")
    directory = page.parent / "figures"
    directory.mkdir(parents=True, exist_ok=True)
    files = [directory / f"{name}.png" for name in drawers]
    with mpl.rc_context(cast("Any", {**mpl.rcParamsDefault, **STYLE, **TITLES})):
        for file, draw in zip(files, drawers.values(), strict=True):
            draw().savefig(file, dpi=DPI, metadata={"Software": None})
    return [page, *files]


def with_tables(text: str, tables: Tables, where: str) -> str:
    """Return a document with its tables replaced; those that are not given stay as they are.

    ValueError, which begins with ``where``, if a table has no marks, or marks have no end.
    """
    places = [match["name"] for match in _BLOCK.finditer(text)]
    for name in re.findall(r"<!-- table: ([\w-]+) -->", text):
        if places.count(name) != 1:
            raise ValueError(f"{where}: table '{name}' has no end; expected a line <!-- end --> behind it")
    absent = [name for name in tables if name not in places]
    if absent:
        raise ValueError(f"{where}: no place for table '{absent[0]}'; expected <!-- table: {absent[0]} -->")

    def replace(match: re.Match[str]) -> str:
        table = tables.get(match["name"])
        body = match["body"] if table is None else f"{table}\n"
        return f"{match['head']}{body}{match['foot']}"

    return _BLOCK.sub(replace, text)


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table in Markdown."""
    head, *lines = (f"| {' | '.join(line)} |" for line in (headings, *rows))
    return "\n".join((head, "|" + "---|" * len(headings), *lines))


def canvas(rows: int, columns: int, panel: float, **shared: Any) -> tuple[Figure, Any]:
    """Return a figure with panels of a height [in], and its axes (rows, columns)."""
    figure = Figure(figsize=(WIDTH, panel * rows + 0.4), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def look(name: str, names: Sequence[str], proposed: str) -> dict[str, Any]:
    """Line of an observer or scheme, the same in every figure of a study."""
    others = [each for each in names if each != proposed]
    style = line_style("proposed") if name == proposed else line_style("compared", others.index(name))
    return {
        "color": style.colour,
        "dashes": style.dashes or (None, None),
        "linewidth": LINE_WIDTH * style.width,
        "zorder": 2.0 + style.layer * 1e-3,
    }


def legend(figure: Figure, ax: Any, columns: int = 5, handles: Sequence[Any] = ()) -> None:
    """Put the legend of one panel, and more handles, above the figure."""
    handles = [*ax.get_legend_handles_labels()[0], *handles]
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, frameon=False)


def plain_ticks(axis: Any) -> None:
    """Write the numbers of a logarithmic axis as they are, without minor ones."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def no_minor(axis: Any) -> None:
    """Leave out the minor ticks of an axis."""
    axis.set_minor_locator(NullLocator())
