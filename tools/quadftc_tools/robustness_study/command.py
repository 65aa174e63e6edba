"""Tables and figures of docs/robustness.md from campaigns that were flown: for scripts/study_robustness."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

import polars as pl

from quadftc_cli.commands import BAD_INPUT, GOOD
from quadftc_cli.tables import console
from quadftc_tools.diagnosis_study.document import with_tables
from quadftc_tools.robustness_study.figures import save_figures
from quadftc_tools.robustness_study.studies import SIZES, STUDIES
from quadftc_tools.robustness_study.tables import size_tables, study_tables

FLIGHTS, DOCUMENT, FIGURES = "flights.parquet", "robustness.md", "figures"


def read_campaigns(results: Path) -> dict[str, pl.DataFrame]:
    """Read the tables of the campaigns, ``RESULTS/study_NAME/flights.parquet``; those that are there.

    Raises
    ------
    ValueError
        If there is none.
    """
    names = (*(study.name for study in STUDIES), SIZES)
    paths = {name: results / f"study_{name}" / FLIGHTS for name in names}
    frames = {name: pl.read_parquet(path) for name, path in paths.items() if path.is_file()}
    if not frames:
        raise ValueError(f"{results}: no study there; expected {paths[SIZES]} or another")
    return frames


def publish(frames: Mapping[str, pl.DataFrame], docs: Path) -> list[Path]:
    """Write the tables into ``robustness.md`` and the figures beside it; return the files.

    Raises
    ------
    ValueError
        If the document has no place for a table.
    OSError
        If a file cannot be read or written.
    """
    tables: dict[str, str] = {}
    for study in STUDIES:
        if study.name in frames:
            tables |= study_tables(study, frames[study.name])
    if SIZES in frames:
        tables |= size_tables(frames[SIZES])
    document = docs / DOCUMENT
    text = with_tables(document.read_text(encoding="utf-8"), tables, str(document))
    document.write_text(text, encoding="utf-8")
    return [document, *save_figures(frames, docs / FIGURES)]


def main() -> int:
    """Run the command; turn wrong input into lines and an exit code."""
    parser = argparse.ArgumentParser(prog="study_robustness", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="directory of the campaigns")
    parser.add_argument("--docs", type=Path, required=True, help="directory of robustness.md and figures/")
    options = parser.parse_args()
    screen = console(stderr=True)
    try:
        for path in publish(read_campaigns(options.results), options.docs):
            screen.print(f"written: {path}", markup=False, soft_wrap=True)
    except (ValueError, OSError) as error:
        screen.print(f"error: {error}", markup=False, soft_wrap=True)
        return BAD_INPUT
    return GOOD


if __name__ == "__main__":
    sys.exit(main())
