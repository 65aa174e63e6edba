"""What each number of the observer `bank` is worth: the figures of its trial with it halved, and doubled.

    python -m quadftc_tools.study.constants --flights 20 --docs docs

A number is a name in capitals, or a parameter; the comment behind it says unit, kind and reason. Each flies
the trial of `quadftc_tools.study.bank_trial`, on seeds of tuning, in a copy of the package. Of a probability
above 0.5, the distance to 1 is halved and doubled. Whole numbers without a comment are indices and counts.
"""

from __future__ import annotations

import argparse
import ast
import functools
import os
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

import quadftc_fdi
from quadftc_cli.screen import say
from quadftc_tools.study.ablation import changed_copy
from quadftc_tools.study.bank_trial import KINDS, NOBODY, PAGE, Judged, judge_flight, seeds_of
from quadftc_tools.study.page import NOTHING, Argument, Tables, markdown, run_study

OBSERVER = "bank"
PACKAGE = Path(quadftc_fdi.__file__).parent
FACTORS = (0.5, 2.0)
HEAD = ("number", "value", "unit", "is", "reason", "halved", "doubled")
COMMENT = re.compile(r"  # (\S+); (measured|derived|chosen|mark|rounding): (.+)$")
UNTUNED = ("mark", "rounding")
WORDS = ("alarms", "named", "misnamed")


class Constant(NamedTuple):
    """A number of the observer, or some that are scaled together."""

    name: str
    value: str  # as it is written
    unit: str
    kind: str
    reason: str
    file: str  # of the package
    line: str

    def changed(self, factor: float) -> str:
        """Return its line with another value."""
        new = f"{factor} * {self.value}"
        match ast.parse(self.value, mode="eval").body:
            case ast.Tuple():
                new = f"tuple(type(x)({factor} * x) for x in {self.value})"
            case ast.Constant(float(value)) if 0.5 < value < 1.0:
                new = f"1.0 - {factor} * (1.0 - {self.value})"
            case _:
                pass
        return self.line.replace(self.value, new, 1)


def read_constants() -> list[Constant]:
    """Return the numbers of the observer; ValueError names one whose comment does not say what it is."""
    paths = *sorted(PACKAGE.glob(f"{OBSERVER}/*.py")), PACKAGE / f"fault_observers/{OBSERVER}.py"
    return [each for path in paths for each in _constants_of(path) if each.kind not in UNTUNED]


def _constants_of(path: Path) -> Iterator[Constant]:
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Assign(targets=[target], value=value) if numbers := _numbers(value):
                found = COMMENT.search(lines[node.lineno - 1])
                if found is None and any(isinstance(each, float) for each in numbers):
                    raise ValueError(f"{path}:{node.lineno}: expected '# unit; kind: reason' behind a number")
                told = found.groups() if found else ()
            case ast.AnnAssign(target=target, value=ast.Call(args=[value], keywords=words)):
                said = {word.arg: ast.literal_eval(word.value) for word in words}
                told = (said.get("unit", "1"), "chosen", said["doc"]) if any(_numbers(value)) else ()
            case _:
                continue
        if told:
            unit, kind, reason = told
            name, written = f"{path.stem}.{ast.unparse(target)}", ast.get_source_segment(text, value) or ""
            file, line = str(path.relative_to(PACKAGE)), lines[node.lineno - 1]
            yield Constant(name, written, unit, kind, reason, file, line)


def _numbers(value: ast.expr) -> list[int | float]:
    """Return the numbers of an expression; none if it has names other than `math`."""
    parts = [*ast.walk(value)]
    if any(isinstance(each, ast.Name) and each.id != "math" for each in parts):
        return []
    numbers = [each.value for each in parts if isinstance(each, ast.Constant)]
    return [each for each in numbers if isinstance(each, int | float) and not isinstance(each, bool)]


def judge(folder: str, seeds: Sequence[int]) -> list[Judged]:
    """Judge flights by the package in a folder, in a process of its own."""
    sys.path.insert(0, folder)  # a process that is spawned takes it over
    try:
        with ProcessPoolExecutor(1, get_context("spawn")) as worker:
            flights = worker.map(functools.partial(judge_flight, observers=[OBSERVER]), seeds)
            return [each for flight in flights for each in flight]
    finally:
        sys.path.remove(folder)


def shares(judged: Sequence[Judged]) -> tuple[float, float, float]:
    """Return how many healthy flights alarm, faults are named, faults and pushes are misnamed [%]."""
    healthy = [each.verdict for each in judged if KINDS[each.kind].sensor == NOBODY]
    faults = [each.verdict for each in judged if KINDS[each.kind].sensor >= 0]
    others = [each.verdict for each in judged if KINDS[each.kind].sensor != NOBODY]
    alarms, misnamed = (100.0 * np.mean([each.wrong for each in group]) for group in (healthy, others))
    return float(alarms), 100.0 * float(np.mean([each.delay is not None for each in faults])), float(misnamed)


def tell_change(usual: Sequence[Judged], judged: Sequence[Judged]) -> str:
    """Say what changes of the same flights: shares [percentage points], mean ratio of the delays of ramps."""
    if usual == judged:
        return "none"
    told = [
        f"{word} {after - before:+.1f}"
        for word, before, after in zip(WORDS, shares(usual), shares(judged), strict=True)
        if round(after - before, 1)
    ]
    ratios = [
        after.verdict.delay / before.verdict.delay
        for before, after in zip(usual, judged, strict=True)
        if KINDS[before.kind].power and before.verdict.delay and after.verdict.delay
    ]
    longer = round(100.0 * (float(np.mean(ratios)) - 1.0)) if ratios else 0
    return ", ".join([*told, *([f"delay {longer:+d} %"] if longer else [])]) or "slight"


def make(options: argparse.Namespace) -> Tables:
    """Fly the trial with each number halved and doubled; return the table."""
    seeds, rows, known = seeds_of("tuning", options.flights), list[tuple[str, ...]](), read_constants()
    absent = {*options.number} - {each.name for each in known}
    if absent:
        raise ValueError(f"--number {min(absent)}: expected one of {', '.join(each.name for each in known)}")
    with tempfile.TemporaryDirectory(prefix="quadftc_") as name:
        os.environ["QUADFTC_CACHE"] = f"{name}/laws"  # no law of a changed copy stays
        usual = judge(str(PACKAGE.parent), seeds)
        told = ", ".join(f"{word} {share:.1f} %" for word, share in zip(WORDS, shares(usual), strict=True))
        rows.append(("none", *[NOTHING] * 4, told, told))
        for each in known:
            if options.number and each.name not in options.number:
                continue
            say(each.name, stderr=True)
            row = [f"`{each.name}`", f"`{each.value}`", *each[2:5]]
            for factor in FACTORS:
                folder = Path(name) / f"{each.name}_{factor}"
                changed_copy(folder, each.file, each.line, each.changed(factor))
                row.append(tell_change(usual, judge(str(folder), seeds)))
            rows.append(tuple(row))
    table = markdown(HEAD, rows)
    return {"most" if options.number else "constants": table}


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table into the page, or print it."""
    known: dict[str, Argument] = {
        "--flights": {"type": int, "default": 20, "help": "of each kind of fault"},
        "--number": {"action": "append", "default": [], "help": "one alone, by its name"},
    }
    return run_study(PAGE, make, known, arguments)


if __name__ == "__main__":
    sys.exit(main())
