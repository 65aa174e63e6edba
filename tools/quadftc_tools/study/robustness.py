"""The studies of docs/robustness.md, from the campaigns ``study_*``; for scripts/study_robustness."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import polars as pl
from matplotlib.figure import Figure

from quadftc_tools.study.page import RESULTS, Drawers, Tables, read_campaigns, run_study
from quadftc_tools.study.robustness_figures import draw_sizes, draw_study
from quadftc_tools.study.robustness_statistics import SIZES, STUDIES


def read_all(results: Path) -> dict[str, pl.DataFrame]:
    """Read the tables of the campaigns that are there, variants in order; ValueError if there is none."""
    found = read_campaigns(results, [f"study_{name}" for name in (SIZES, *(study.name for study in STUDIES))])
    frames: dict[str, pl.DataFrame] = {}
    for name, frame in found.items():
        variants = json.loads((results / name / "campaign.json").read_text(encoding="utf-8"))["variants"]
        frames[name.removeprefix("study_")] = frame.cast({"variant": pl.Enum(variants)})
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
    sys.exit(run_study(page, lambda options: make(read_all(options.results)), found))
