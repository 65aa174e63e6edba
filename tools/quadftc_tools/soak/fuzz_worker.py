# pyright: basic
"""Feeds programs bad input until it is stopped; tells on stdout what came of it, one JSON object a line.

``python3 -m quadftc_tools.soak.fuzz_worker FOLDER SEED TARGET...``. In ``FOLDER/now.json`` is the input that
is tried: what is left there when the process ends by itself, or hangs, is what ended it.
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
from random import Random
from typing import Any

from quadftc_tools.soak.fuzz_case import Case, try_case
from quadftc_tools.soak.fuzz_seeds import Seeds
from quadftc_tools.soak.fuzz_targets import TARGETS

SLICE = 4.0  # s, of a target with a share of 1, before the next takes its turn
MEMORY = 12 * 1024**3  # bytes of address space; beyond, memory is refused
NOW, SANDBOX, SEEDS = "now.json", "sandbox", "seeds"


def work(folder: Path, seed: int, names: list[str]) -> None:
    """Try inputs, target by target, for ever; first those in ``FOLDER/again``."""
    told = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    warnings.simplefilter("ignore")  # of numbers that overflow
    os.environ["QUADFTC_DEBUG"] = "1"  # where an internal error is
    shutil.rmtree(folder / SEEDS, ignore_errors=True)
    seeds = Seeds(folder / SEEDS)
    seeds.prepare()
    _tell(told, ready=True)
    for path in sorted((folder / "again").glob("*.json")):
        case = Case.load(path.read_text("utf-8"))
        if case.target in names:
            _try(case, folder, told, again=path.name)
    counts = dict.fromkeys(names, 0)
    for name in itertools.cycle(names):
        end = time.monotonic() + SLICE * TARGETS[name].share
        while time.monotonic() < end:
            random = Random(f"{name} {seed} {counts[name]}")
            counts[name] += 1
            _try(TARGETS[name].case(seeds, random), folder, told)


def _try(case: Case, folder: Path, told: Any, **about: Any) -> None:
    text = case.dump()
    (folder / NOW).write_text(text, encoding="utf-8")
    outcome = try_case(case, TARGETS[case.target].program, folder / SANDBOX)
    more = {"case": text} if outcome.wrong else {}
    _tell(
        told,
        target=case.target,
        code=outcome.code,
        seconds=outcome.seconds,
        cpu=outcome.cpu,
        wrong=outcome.wrong,
        **about,
        **more,
    )


def _tell(told: Any, **what: Any) -> None:
    told.write(json.dumps(what) + "\n")
    told.flush()


if __name__ == "__main__":
    work(Path(sys.argv[1]).resolve(), int(sys.argv[2]), sys.argv[3:])
