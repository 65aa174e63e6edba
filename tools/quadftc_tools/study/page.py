# pyright: basic
"""What the pages of the studies share: their tables between marks, and the command.

A table stands in the document between <!-- table: NAME --> and <!-- end -->, so that nobody copies a number.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from quadftc_cli.commands import BAD_INPUT, GOOD
from quadftc_cli.screen import say

NOTHING = "-"
FLIGHTS = "flights.parquet"
_BLOCK = re.compile(
    r"(?P<head><!-- table: (?P<name>[\w-]+) -->\n)(?P<body>.*?)(?P<foot><!-- end -->)", re.DOTALL
)

Argument = dict[str, Any]  # how a parser adds it
Tables = Mapping[str, str]  # by the name of the place
RESULTS: Argument = {"type": Path, "required": True, "help": "directory of the campaigns"}


def read_campaigns(results: Path, names: Sequence[str]) -> dict[str, pl.DataFrame]:
    """Read the tables ``RESULTS/NAME/flights.parquet`` that are there; ValueError if there is none."""
    paths = {name: results / name / FLIGHTS for name in names}
    frames = {name: pl.read_parquet(path) for name, path in paths.items() if path.is_file()}
    if not frames:
        raise ValueError(f"{results}: no study there; expected {names[0]}/{FLIGHTS} or another")
    return frames


def run_study(
    page: str,
    make: Callable[[argparse.Namespace], Tables],
    arguments: Mapping[str, Argument],
    given: Sequence[str] | None = None,
) -> int:
    """Make the tables of a study from its arguments; put them into its page, or print them.

    The page is in the directory ``--docs``. Input that is wrong gives a line, and the exit code of such.
    """
    parser = argparse.ArgumentParser(description=f"Tables of docs/{page}.")
    for name, settings in arguments.items():
        parser.add_argument(name, **settings)
    parser.add_argument("--docs", type=Path, help=f"directory of {page}; without it, tables are printed")
    options = parser.parse_args(given)
    try:
        tables = make(options)
        if options.docs is None:
            say(*(f"{name}\n{table}\n" for name, table in tables.items()))
        else:
            write_tables(options.docs / page, tables)
    except (ValueError, OSError) as error:
        say(f"error: {error}", stderr=True)
        return BAD_INPUT
    return GOOD


def write_tables(path: Path, tables: Tables) -> None:
    """Renew tables of a document, and say so."""
    path.write_text(with_tables(path.read_text(encoding="utf-8"), tables, str(path)), encoding="utf-8")
    say(f"written: {path}", stderr=True)


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
