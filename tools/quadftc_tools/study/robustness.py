"""The studies of docs/robustness.md, from the campaigns ``study_*``; for scripts/study_robustness."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import polars as pl
from matplotlib.figure import Figure

from quadftc_tools.study.page import FLIGHTS, RESULTS, Drawers, Tables, run_study
from quadftc_tools.study.robustness_figures import draw_sizes, draw_study
from quadftc_tools.study.robustness_statistics import SIZES, STUDIES


def read_campaigns(results: Path) -> dict[str, pl.DataFrame]:
    """Read the tables ``RESULTS/study_NAME/flights.parquet`` that are there; ValueError if there is none."""
    frames: dict[str, pl.DataFrame] = {}
    for name in (*(study.name for study in STUDIES), SIZES):
        path = results / f"study_{name}" / FLIGHTS
        if path.is_file():
            variants = json.loads((path.parent / "campaign.json").read_text(encoding="utf-8"))["variants"]
            frames[name] = pl.read_parquet(path).with_columns(pl.col("variant").cast(pl.Enum(variants)))
    if not frames:
        raise ValueError(f"{results}: no study there; expected study_{SIZES}/{FLIGHTS} or another")
    return frames


def make(frames: Mapping[str, pl.DataFrame]) -> tuple[Tables, Drawers]:
    """Return no tables and the figures of campaigns, whose flights are given by name."""
    drawers: dict[str, Callable[[], Figure]] = {}
    for study in (study for study in STUDIES if study.name in frames):
        drawers[f"robustness_{study.name}"] = functools.partial(draw_study, study, frames[study.name])
    if SIZES in frames:
        drawers[f"robustness_{SIZES}"] = functools.partial(draw_sizes, frames[SIZES])
    return {}, drawers


if __name__ == "__main__":
    page, found = "robustness.md", {"--results": RESULTS}
    sys.exit(run_study(page, lambda options: make(read_campaigns(options.results)), found))
