"""The study of docs/diagnosis.md: every fault observer through random faults, without a control loop.

It reads the campaigns ``study_diagnosis_*``; for scripts/study_diagnosis.
"""

from __future__ import annotations

import functools
import json
import sys
from pathlib import Path
from typing import Any

import polars as pl

from quadftc_tools.study.diagnosis_figures import FIGURES
from quadftc_tools.study.diagnosis_quiet import QUIET, quiet_results
from quadftc_tools.study.diagnosis_results import TITLES, setting_results
from quadftc_tools.study.diagnosis_tables import tables
from quadftc_tools.study.page import FLIGHTS, RESULTS, Drawers, Tables, run_study

PREFIX = "study_diagnosis_"


def read_results(directory: Path) -> dict[str, Any]:
    """Return the results of the campaigns in a directory, ready for JSON; ValueError if there is none."""
    paths = {path.parent.name: path for path in directory.glob(f"{PREFIX}*/{FLIGHTS}")}
    found: dict[str, Any] = {}
    for name in (*TITLES, *QUIET):
        if PREFIX + name not in paths:
            continue
        frame = pl.read_parquet(paths[PREFIX + name])
        manifest = json.loads((directory / (PREFIX + name) / "campaign.json").read_text(encoding="utf-8"))
        if name in QUIET:
            found[name] = quiet_results(name, frame, manifest)
        else:
            path = paths.get(f"{PREFIX}{name}_levels")
            levels = None if path is None else pl.read_parquet(path)
            found[name] = setting_results(name, frame, levels, manifest)
    if not found:
        raise ValueError(
            f"{directory}: holds no campaign of this study; expected {PREFIX}{next(iter(TITLES))}"
        )
    return found


def make(directory: Path) -> tuple[Tables, Drawers]:
    """Return tables and figures of the campaigns in a directory."""
    results = read_results(directory)
    figured = {name: each for name, each in results.items() if "roc" in each}
    drawers = {name: functools.partial(draw, figured) for name, draw in FIGURES.items() if figured}
    return tables(results), drawers


if __name__ == "__main__":
    sys.exit(run_study("diagnosis.md", lambda options: make(options.results), {"--results": RESULTS}))
