# pyright: basic
"""Feeds programs bad input until it is stopped; prints what came of each, one JSON object a line.

``python3 -m quadftc_tools.soak.fuzz_worker FOLDER SEED TARGET...``. ``FOLDER/now.json`` holds the input that
is being tried: if the process ends by itself, or hangs, that input was the cause.
"""

from __future__ import annotations

import itertools
import json
import os
import resource
import shutil
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import hypothesis
from hypothesis import strategies as st
from hypothesis.configuration import set_hypothesis_home_dir

from quadftc_tools.soak.fuzz_case import NOW, Case, try_case
from quadftc_tools.soak.fuzz_seeds import Seeds
from quadftc_tools.soak.fuzz_targets import TARGETS

SLICE = 4.0  # s, of a target with a share of 1, before the next takes its turn
EXAMPLES = 10  # that Hypothesis draws from one seed
MEMORY = 12 * 1024**3  # bytes of address space; beyond, memory is refused
DRAWING = hypothesis.settings(
    max_examples=EXAMPLES,
    phases=(hypothesis.Phase.generate,),
    suppress_health_check=(hypothesis.HealthCheck.too_slow, hypothesis.HealthCheck.data_too_large),
    database=None,
    deadline=None,
    derandomize=False,
)


def work(folder: Path, seed: int, names: list[str]) -> None:
    """Try inputs without end, target by target; first those in ``FOLDER/again``."""
    lines = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    warnings.simplefilter("ignore")  # of numbers that overflow
    os.environ["QUADFTC_DEBUG"] = "1"  # shows where an internal error is
    set_hypothesis_home_dir(folder / "hypothesis")
    shutil.rmtree(folder / "seeds", ignore_errors=True)
    seeds = Seeds(folder / "seeds")
    seeds.prepare()

    def tell(**what: Any) -> None:
        lines.write(json.dumps(what) + "\n")
        lines.flush()

    def attempt(case: Case, again: str) -> None:
        text = case.dump()
        (folder / NOW).write_text(text, encoding="utf-8")
        outcome = try_case(case, TARGETS[case.target].program, folder / "sandbox")
        what = {"target": case.target, "code": outcome.code, "wrong": outcome.wrong, "again": again}
        tell(**what, seconds=outcome.seconds, cpu=outcome.cpu, case=text if outcome.wrong else "")

    tell(ready=True)
    for path in sorted((folder / "again").glob("*.json")):
        case = Case.load(path.read_text("utf-8"))
        if case.target in names:
            attempt(case, path.name)
    rounds = itertools.count()
    for name in itertools.cycle(names):
        cases, end = TARGETS[name].cases(seeds), time.monotonic() + SLICE * TARGETS[name].share
        while time.monotonic() < end:
            drawn = hypothesis.given(cases, st.just(""))(attempt)
            hypothesis.seed(f"{name} {seed} {next(rounds)}")(DRAWING(drawn))()


if __name__ == "__main__":
    work(Path(sys.argv[1]).resolve(), int(sys.argv[2]), sys.argv[3:])
